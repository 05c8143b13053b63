# SPDX-License-Identifier: Apache-2.0
"""Whether the stamps of the truth are off: another computer's clock looks like an error of the estimate."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.types import NS_PER_S

MOST_S, STEP_S = 2.0, 0.1  # offsets that are tried, before the best is refined
TOLERANCE_S = 1e-4
MOST_LEFT = 0.5  # of the error: drift, too, becomes a little smaller with other stamps
LEAST_M = 1e-3  # of an error: rounded stamps and positions are no clock
MOST_POSES, FEWEST_POSES = 500, 10


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """What moving the stamps of the truth changes.

    Attributes:
        offset_s: to be added to the stamps of the truth [s].
        ate_m: error with the stamps as they are, aligned in rotation and position [m].
        moved_ate_m: the same with the stamps moved [m].
    """

    offset_s: float
    ate_m: float
    moved_ate_m: float

    def text(self, given_s: float = 0.0) -> str:
        """Return what was found and what to give, if `given_s` [s] were added to the stamps already."""
        return (
            f"the clock of the ground truth seems to be off: with {self.offset_s:+.3f} s {'more ' if given_s else ''}"
            f"added to its stamps, ATE SE3 is {self.moved_ate_m:.3g} m instead of {self.ate_m:.3g} m; "
            f"score so by `uav-vslam evaluate ... --truth-offset {given_s + self.offset_s:z.3f}`"
        )


def clock_offset(estimate: Trajectory, truth: Trajectory) -> ClockOffset | None:
    """Return the offset of the truth's clock that explains most of the estimate's error; None if there is none.

    Any alignment in rotation and position is forgiven, so that an offset that looks like one, as on a straight flight
    of constant speed, is not found.
    """
    every = max(1, len(estimate) // MOST_POSES)
    estimate = estimate.select(np.arange(0, len(estimate), every))
    unmoved = absolute_error(estimate, truth, alignment="se3")
    if unmoved is None or unmoved.pairs < FEWEST_POSES or unmoved.ate_m < LEAST_M:
        return None
    fewest = max(FEWEST_POSES, unmoved.pairs // 2)  # a short overlap is easily fitted

    def ate_m(offset_s: float) -> float:
        error = absolute_error(estimate, later(truth, offset_s), alignment="se3")
        return np.inf if error is None or error.pairs < fewest else error.ate_m

    tried_s = np.arange(-MOST_S, MOST_S + 0.5 * STEP_S, STEP_S)
    nearest_s = float(tried_s[np.argmin([ate_m(offset_s) for offset_s in tried_s])])
    bounds = (nearest_s - STEP_S, nearest_s + STEP_S)
    with np.errstate(invalid="ignore"):  # next to an offset without an error, the minimiser's parabola is none
        best = minimize_scalar(ate_m, bounds=bounds, method="bounded", options={"xatol": TOLERANCE_S})
    if not best.fun <= MOST_LEFT * unmoved.ate_m:
        return None
    return ClockOffset(float(best.x), unmoved.ate_m, float(best.fun))


def later(trajectory: Trajectory, seconds: float) -> Trajectory:
    """Return a trajectory with all stamps moved."""
    return dataclasses.replace(trajectory, stamps_ns=trajectory.stamps_ns + round(seconds * NS_PER_S))
