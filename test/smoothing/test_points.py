# SPDX-License-Identifier: Apache-2.0
"""Which points of a flight pass the gate."""

import numpy as np

from uav_vslam.config import RigConfig
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.smoothing.cameras import Cameras, PixelNoise, RigEstimate
from uav_vslam.smoothing.points import fitting, triangulated
from uav_vslam.smoothing.sightings import Sightings
from uav_vslam.types import NavState

NOISE = PixelNoise(0.5, 0.2, 1e-3)
SEEN = [(0, 0), (1, 0), (2, 1), (0, 2), (1, 2), (2, 3), (2, 4)]  # state and point of each observation
LANDMARKS = np.array([-1, -1, 0, 0, 0])  # the last three points show one landmark


def test_one_view_is_enough_where_the_landmark_was_seen_before() -> None:
    zero, states = np.zeros(3), np.array([state for state, _ in SEEN])
    flown = [NavState(k, Pose(np.eye(3), np.array([4.0 * k, 0, 70])), zero, zero, zero) for k in range(3)]
    cameras = Cameras(flown, [Turning.none()] * 3, RigEstimate.of(kagaru_rig(), RigConfig(), len(flown)))
    own = np.array([point for _, point in SEEN])
    ground = np.array([[3.0, 2, 0], [5, -4, 1], [6, 1, 0], [6, 1, 0], [6, 1, 0]])
    pixels = cameras.rig.project(cameras.points_left(states, ground[own]))
    pixels[-1, 3] += 20.0  # a wrong match: the right feature is off its epipolar line
    sightings = Sightings(states, own, pixels, LANDMARKS, np.arange(1, 6), True)
    points = triangulated(sightings, cameras)
    kept = fitting(sightings, cameras, points, NOISE, probability=0.999)
    np.testing.assert_array_equal(kept, [True, False, True, True, False])
