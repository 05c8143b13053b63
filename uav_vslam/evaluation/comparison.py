# SPDX-License-Identifier: Apache-2.0
"""Several estimates against their ground truth: the figures of `comparison.json`.

Truth and estimate must be poses of the same body frame; nothing estimates a lever arm between two frames.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.evaluation.alignment import ALIGNMENTS
from uav_vslam.evaluation.clock_offset import clock_offset
from uav_vslam.evaluation.pairing import MAX_GAP_S, pair_with_truth
from uav_vslam.evaluation.plain import plain
from uav_vslam.evaluation.scores import consistency_scores, relative_scores
from uav_vslam.evaluation.segments import SegmentError, default_lengths_m, distances_m, pooled, segment_errors
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]
Figures = dict[str, Any]

WRONG_UNIT = 1e4  # factor between the stamps of two trajectories that is no difference of clocks


@dataclass(frozen=True, slots=True)
class Run:
    """An estimate to be scored.

    Attributes:
        source: name of the file or results folder that it is from.
        track: vehicle and estimate in a results folder; empty for a file.
        estimate, truth: trajectories of the same body frame; their world frames may differ.
    """

    source: str
    track: str
    estimate: Trajectory
    truth: Trajectory

    @property
    def label(self) -> str:
        """Its name in errors and in the plot."""
        return f"{self.source} {self.track}".rstrip()


@dataclass(frozen=True, slots=True)
class PairedRun:
    """The part of a run that has ground truth.

    Attributes:
        run: the whole.
        estimate: the poses with ground truth.
        truth: the true pose of each.
    """

    run: Run
    estimate: Trajectory
    truth: Trajectory

    @property
    def true_path(self) -> Trajectory:
        """All true poses between the first and the last of the compared ones."""
        return self.run.truth.between(int(self.truth.stamps_ns[0]), int(self.truth.stamps_ns[-1]))

    @property
    def flown_m(self) -> Array:
        """(N,) distance along the whole true path from the first compared pose to each [m]."""
        first_ns, whole = self.truth.stamps_ns[0], self.run.truth
        flown = np.interp(self.truth.stamps_ns - first_ns, whole.stamps_ns - first_ns, distances_m(whole))
        return np.asarray(flown - flown[0])


def pair_run(run: Run, *, max_gap_s: float = MAX_GAP_S) -> PairedRun:
    """Interpolate the truth to the estimate's stamps, but not across longer gaps than `max_gap_s` [s].

    Raises:
        TrajectoryFileError: no pose has ground truth; the text says why.
    """
    estimate, truth = pair_with_truth(run.estimate, run.truth, max_gap_s=max_gap_s)
    if len(estimate) == 0:
        raise TrajectoryFileError(f"{run.label}: no pose has ground truth: {_reason(run, max_gap_s)}")
    return PairedRun(run, estimate, truth)


def compare(
    runs: Sequence[PairedRun], *, name: str, git: str | None, lengths_m: Sequence[float] | None = None
) -> Figures:
    """Return the content of `comparison.json`.

    Args:
        runs: at least one.
        name: of the comparison.
        git: revision of the code, or None where it isn't known.
        lengths_m: of the segments for the drift [m]; by default those that fit the shortest path.
    """
    lengths_m = lengths_m or default_lengths_m(min(run.truth.path_length_m for run in runs))
    figures = [_figures(run, lengths_m) for run in runs]
    tree = {"comparison": name, "git": git, "segments_m": list(lengths_m), "runs": figures}
    return dict(plain(tree))


def aligned_positions(run: PairedRun, alignment: str) -> Array:
    """Return the (N, 3) estimated positions [m] in the frame of the truth by an alignment of `ALIGNMENTS`."""
    return ALIGNMENTS[alignment](run.estimate.positions, run.truth.positions).apply(run.estimate.positions)


def _figures(run: PairedRun, lengths_m: Sequence[float]) -> Figures:
    absolute = {name: absolute_error(run.estimate, run.truth, alignment=name) for name in ALIGNMENTS}
    determined = {"none"} if len(run.estimate) == 1 else set(ALIGNMENTS)  # a single pose can be moved onto any other
    errors = segment_errors(run.estimate, run.truth, lengths_m)
    consistency = consistency_scores(run.estimate, run.truth)
    offset = clock_offset(run.estimate, run.run.truth)
    return {
        "source": run.run.source,
        "track": run.run.track,
        "poses": len(run.run.estimate),
        "poses_with_truth": len(run.estimate),
        "distance_m": float(run.flown_m[-1]),
        "ate_m": {name: error.ate_m if name in determined else None for name, error in absolute.items() if error},
        "end_m": {name: error.end_m for name, error in absolute.items() if error},
        "height_rms_m": absolute["none"].height_rms_m if absolute["none"] else None,
        "rotation_rms_deg": {name: math.degrees(error.rotation_rms_rad) for name, error in absolute.items() if error},
        **relative_scores(run.estimate, run.truth),
        "rpe": _drift(pooled(errors)),
        "rpe_by_segment": [_drift(error) for error in errors],
        "nees_position": consistency["nees_position"],
        "nees_rotation": consistency["nees_rotation"],
        "clock_offset": dataclasses.asdict(offset) if offset else None,
    }


def _drift(error: SegmentError) -> Figures:
    return {
        "segment_m": error.length_m,
        "translation_percent": 100.0 * error.translation,
        "rotation_deg_per_100m": 100.0 * math.degrees(error.rotation),
        "segments": error.segments,
    }


def _reason(run: Run, max_gap_s: float) -> str:
    """Return why no pose of a run could be paired."""
    first, last = (trajectory.stamps_ns[[0, -1]] / NS_PER_S for trajectory in (run.estimate, run.truth))
    spans = f"its stamps are {first[0]:.3f} to {first[1]:.3f} s, those of the truth {last[0]:.3f} to {last[1]:.3f} s"
    if first[0] <= last[1] and last[0] <= first[1]:
        gap_s = float(np.median(np.diff(run.truth.stamps_ns))) / NS_PER_S if len(run.truth) > 1 else math.inf
        return f"{spans}, but the truth's poses are {gap_s:.2f} s apart; allow it by --max-gap (now {max_gap_s:g} s)"
    ratio = max(abs(first[1]), 1e-9) / max(abs(last[1]), 1e-9)
    unit = " (is one of them in another unit?)" if not 1.0 / WRONG_UNIT < ratio < WRONG_UNIT else ""
    return f"{spans}{unit}; both need the same clock"
