# SPDX-License-Identifier: Apache-2.0
"""What the command says beside its results, on standard error."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uav_vslam.evaluation.result import FlightResult
    from uav_vslam.evaluation.trajectory import Trajectory


DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def say(text: str) -> None:
    """Print a line."""
    print(f"uav-vslam: {text}", file=sys.stderr)


def warn(text: str) -> None:
    """Print a warning."""
    say(f"warning: {text}")


def warn_each(texts: Iterable[str]) -> None:
    """Print warnings, each once: vehicles may share a bag and a configuration."""
    for text in dict.fromkeys(texts):
        warn(text)


def warn_of_truth(result: FlightResult, truths: Mapping[str, Trajectory | None]) -> None:
    """Warn where the recorded truth seems to have another time, unit or axes than the estimate, or no attitude."""
    from uav_vslam.datasets.truth import no_attitude, other_axes, other_time, other_unit

    for vehicle, truth in truths.items():
        if truth is not None:
            estimate = result.vehicles[vehicle].s_slam
            doubts = (doubt(truth, estimate) for doubt in (other_time, other_unit, no_attitude, other_axes))
            warn_each(f"{vehicle}: {text}" for text in doubts if text)
