# SPDX-License-Identifier: Apache-2.0
"""The recorded ground truth as a trajectory for evaluation."""

from collections.abc import Iterator

import numpy as np

from uav_vslam.datasets.truth_track import TruthTrack
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation
from uav_vslam.types import NS_PER_S

MAX_SPACING_S = MAX_GAP_S  # of poses against which estimates are scored


def trajectory_of(truth: TruthTrack) -> Trajectory:
    """Return recorded ground truth as a trajectory."""
    return Trajectory(truth.stamps_ns, truth.positions_world, quaternion_wxyz_from_rotation(truth.R_world_body))


def truth_warnings(truth: TruthTrack) -> Iterator[str]:
    """Yield why ground truth serves less than it seems to."""
    if truth.left_out:
        yield f"{truth.left_out} poses of the ground truth are not finite, or have no orientation, and are left out"
    if (apart_s := spacing_s(truth)) > MAX_SPACING_S:
        yield (
            f"the poses of the ground truth are {apart_s:.2g} s apart; estimates in gaps of more than "
            f"{MAX_SPACING_S:g} s are not scored, unless by `uav-vslam evaluate RESULTS --max-gap S`"
        )


def spacing_s(truth: TruthTrack) -> float:
    """Return the median time between two poses [s]; 0 if there is one only."""
    return float(np.median(np.diff(truth.stamps_ns))) / NS_PER_S if len(truth) > 1 else 0.0
