# SPDX-License-Identifier: Apache-2.0
"""Flies the first frames again, as they are behind a rolling shutter that was not configured.

The readout is known after some frames, by when it has led the filter astray. So a second flight begins at the start
state and uses the same frames with the readout that was measured; it goes on if they fit it better.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.slam_flight import SlamFlight
from uav_vslam.types import ImuIncrement, StereoFeatures

MOST_FRAMES = 60  # that are kept for it
AGAIN = "from its start state on, with the same frames and the readout that was measured"


class FirstFrames:
    """The frames of a flight while the readout of its cameras is not known."""

    def __init__(self) -> None:
        self._kept: list[tuple[StereoFeatures, ImuIncrement | None]] | None = []
        self._outputs: list[FrameOutput] = []

    def __getstate__(self) -> dict[str, Any]:
        """Leave the frames out of checkpoints: what goes on from one is not flown again."""
        return self.__dict__ | {"_kept": None, "_outputs": []}

    def add(
        self,
        features: StereoFeatures,
        increment: ImuIncrement | None,
        flight: SlamFlight,
        output: FrameOutput,
        begin: Callable[[float], SlamFlight],
    ) -> tuple[SlamFlight, FrameOutput]:
        """Return the flight to go on with after a frame, and the output of that frame.

        Args:
            features: of the frame.
            increment: up to the frame.
            flight: has processed the frame.
            output: of the frame.
            begin: returns a flight that begins at the same start state with another readout [s].
        """
        if self._kept is None:
            return flight, output
        self._kept.append((features, increment))
        self._outputs.append(output)
        if not flight.is_readout_known and len(self._kept) < MOST_FRAMES:
            return flight, output
        frames, flown, self._kept, self._outputs = self._kept, self._outputs, None, []
        if flight.contradicting_readout_s is None:
            return flight, output
        again = begin(flight.contradicting_readout_s)
        again.backend.continue_ids(flight.backend)
        outputs = [again.process(*frame) for frame in frames]
        if _fit(outputs) <= _fit(flown):
            return flight, output
        *earlier, last = outputs
        report = dataclasses.replace(last.report, recovery=AGAIN)
        told = (*output.warnings, f"the filter was re-initialised: {AGAIN}")
        warnings = (*told, *(text for one in outputs for text in one.warnings))
        return again, dataclasses.replace(last, report=report, warnings=warnings, earlier=tuple(earlier))


def _fit(outputs: list[FrameOutput]) -> tuple[int, int]:
    """Return how well frames fit a flight: minus how many are lost, then how many points corrected the state.

    The first two don't count: where the readout is not zero, nothing is known to fit them.
    """
    reports = [output.report for output in outputs[2:]]
    lost = sum(report.coasted or report.recovery != "" for report in reports)
    return -lost, sum(report.associated for report in reports)
