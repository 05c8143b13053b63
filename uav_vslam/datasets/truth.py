# SPDX-License-Identifier: Apache-2.0
"""The recorded ground truth as a trajectory for evaluation."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.messages import TRUTH_TYPES
from uav_vslam.datasets.truth_track import TruthTrack
from uav_vslam.evaluation.attitude import LEAST_TURN_RAD, lacks_attitude, largest_turn_rad, never_turns, turn_between
from uav_vslam.evaluation.pairing import MAX_GAP_S, pair_with_truth
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation
from uav_vslam.types import NS_PER_S

MAX_SPACING_S = MAX_GAP_S  # of poses against which estimates are scored
UNITS_M = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048, "kilometres": 1e3}  # that positions come in
UNIT_SPREAD = 0.2  # relative, around such a factor: errors of an estimate
MOST_SCALE = 10.0  # between true and estimated distances: more is no error of an estimate
ALIKE = 0.2  # turns of poses about their mean, over the mean: more is an error of the estimate
LEAST_SPREAD_M = 1.0  # of positions about their mean, from which scales are compared


def trajectory_of(truth: TruthTrack) -> Trajectory:
    """Return recorded ground truth as a trajectory."""
    return Trajectory(truth.stamps_ns, truth.positions_world, quaternion_wxyz_from_rotation(truth.R_world_body))


def unread_text(topic: str, msgtype: str) -> str:
    """Return that ground truth has a type that is not read."""
    return f"{topic} holds {msgtype} and is not read: record one of {', '.join(TRUTH_TYPES)}"


def left_out_text(left_out: int, remaining: int) -> str:
    """Return that poses of ground truth are left out, by their number and that of the others."""
    none = "" if remaining else "; none remains, so nothing is compared with it"
    return f"{left_out} poses of the ground truth are not finite, unreadable or lack a rotation, and are left out{none}"


def truth_warnings(truth: TruthTrack) -> Iterator[str]:
    """Yield why ground truth serves less than it seems to."""
    if truth.left_out:
        yield left_out_text(truth.left_out, len(truth))
    if truth.set_back:
        yield f"the clock of the ground truth was set back: the {truth.set_back} poses that follow are left out"
    if (apart_s := spacing_s(truth)) > MAX_SPACING_S:
        yield (
            f"the poses of the ground truth are {apart_s:.2g} s apart; estimates in gaps of more than "
            f"{MAX_SPACING_S:g} s are not scored, unless by `uav-vslam evaluate RESULTS --max-gap S`"
        )


def other_time(truth: Trajectory, flight: Trajectory) -> str:
    """Return when ground truth begins and ends if it is not that of a flight's time; otherwise nothing."""
    if len(truth) == 0 or len(flight) == 0:
        return ""
    first_ns, last_ns = int(flight.stamps_ns[0]), int(flight.stamps_ns[-1])
    if len(truth.between(first_ns, last_ns)) > 1:
        return ""
    begins_s, ends_s = (truth.stamps_ns[[0, -1]] - first_ns) / NS_PER_S
    return (
        f"the ground truth is from {begins_s:+.2f} to {ends_s:+.2f} s after the first frame, so nothing is compared "
        "with it: correct its stamps to the sensors' clock"
    )


def unit_of(scale: float) -> str:
    """Return the unit of ground truth, by true distances [m] over those of the ground truth; empty where none fits."""
    return next((name for name, unit_m in UNITS_M.items() if abs(scale / unit_m - 1.0) <= UNIT_SPREAD), "")


def other_unit(truth: Trajectory, flight: Trajectory) -> str:
    """Return how much larger or smaller ground truth is than a flight, if that is too much for an error; or nothing."""
    estimate, reference = pair_with_truth(flight, truth)
    flown, true = (_spread(positions) for positions in (estimate.positions, reference.positions))
    if max(flown, true) < LEAST_SPREAD_M or true <= MOST_SCALE * flown <= MOST_SCALE**2 * true:
        return ""
    times = true / flown if flown > 0.0 else float("inf")
    unit = unit_of(1.0 / times) if times > 0.0 else ""
    said = f", as if it were in {unit}: give its positions in metres" if unit else ""
    return (
        f"the ground truth extends over {times:.3g} times what the estimate does{said}; errors mean nothing before "
        "that is clear, unless the estimate has diverged"
    )


def no_attitude(truth: Trajectory, flight: Trajectory) -> str:
    """Return that ground truth holds positions alone, if it never turns and a flight does; otherwise nothing."""
    if not lacks_attitude(truth, flight):
        return ""
    return (
        "the orientation of the ground truth never changes, while the estimate turns by up to "
        f"{math.degrees(largest_turn_rad(flight)):.0f} deg: errors of attitude, and those expressed in the body, are "
        "left out; where the start defines the map, the truth's heading is fitted to the estimate"
    )


def other_axes(truth: Trajectory, flight: Trajectory) -> str:
    """Return that ground truth has the attitude of other axes than the body's, if it is turned alike in all poses."""
    estimate, reference = pair_with_truth(flight, truth)
    if min(_spread(estimate.positions), _spread(reference.positions)) < LEAST_SPREAD_M or never_turns(reference):
        return ""
    angle, unlike = turn_between(estimate, reference)
    if angle <= LEAST_TURN_RAD or unlike > ALIKE * angle:
        return ""
    return (
        f"the ground truth is turned by {math.degrees(angle):.0f} deg against the body, alike in all poses within "
        f"{math.degrees(unlike):.1f} deg rms: it is of other axes. Errors of attitude, NEES and, if the start defines "
        "the map, unaligned positions mean nothing: give it for the body's frame"
    )


def _spread(positions: NDArray[np.float64]) -> float:
    """Return the root mean square distance of (N, 3) positions from their mean [m]; 0 if there are none."""
    return float(np.sqrt(positions.var(axis=0).sum())) if len(positions) else 0.0


def spacing_s(truth: TruthTrack) -> float:
    """Return the median time between two poses [s]; 0 if there is one only."""
    return float(np.median(np.diff(truth.stamps_ns))) / NS_PER_S if len(truth) > 1 else 0.0
