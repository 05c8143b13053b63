# SPDX-License-Identifier: Apache-2.0
"""Start state of a vehicle in flight over ground that a loaded map covers.

As `in_flight_initializer`, a window of frames gives velocity, gravity and the gyroscope's bias. The map gives the pose
of its first frame, with the map's own errors in the covariance; gravity corrects its tilt, and must agree with it. The
map's frame becomes the vehicle's, and the filter starts with all frames of the window.
"""

import numpy as np
from scipy.special import chdtri

from uav_vslam.config import VehicleConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, NAV_DIM, POSITION, ROTATION, VELOCITY
from uav_vslam.numerics import symmetrise
from uav_vslam.slam.in_flight_initializer import PRIOR_PER_TILT_SIGMA, InFlightInitializer, InsufficientEvidence
from uav_vslam.slam.saved_map import SavedMap
from uav_vslam.slam.saved_map.locate import Located, MapLocator
from uav_vslam.slam.visual_inertial_alignment import Alignment
from uav_vslam.types import NavEstimate, NavState, PoseEstimate, StereoFeatures

TILT_PROBABILITY = 0.9999  # of a correct pose to agree with gravity


class MapInitializer(InFlightInitializer):
    """Finds the start in a map; slides on while a frame is not recognised."""

    def __init__(self, rig: StereoRig, config: VehicleConfig, saved: SavedMap) -> None:
        super().__init__(rig, config)
        self._locator = MapLocator(saved, rig, config)

    def _start_state(self, first: StereoFeatures, found: Alignment) -> NavEstimate:
        located = self._locator.locate(first)
        if located is None:
            raise InsufficientEvidence(self._locator.reason)
        pose = self._levelled(first.stamp_ns, located, found)
        imu, R = self._config.imu, pose.T_map_body.R
        covariance = np.zeros((NAV_DIM, NAV_DIM))
        rows = np.r_[POSITION, ROTATION]
        covariance[np.ix_(rows, rows)] = pose.covariance
        for rows, sigma in (
            (VELOCITY, self._config.start.velocity_sigma),
            (GYRO_BIAS, imu.gyro_bias_sigma),
            (ACCEL_BIAS, imu.accel_bias_sigma),
        ):
            covariance[rows, rows] = sigma**2 * np.eye(3)
        state = NavState(first.stamp_ns, pose.T_map_body, R @ found.velocity, found.gyro_bias, np.zeros(3))
        return NavEstimate(state, covariance)

    def _levelled(self, stamp_ns: int, located: Located, found: Alignment) -> PoseEstimate:
        """Return the pose with roll and pitch corrected by gravity, and its position with them.

        From one view of flat ground, tilt can hardly be told from a shift. The measured vertical is the map frame's:

            R up_body = Exp(-xi) z   =>   z = H xi with H = [I_2, 0] about east and north, R = sigma^2 I

        Raises:
            InsufficientEvidence: they disagree.
        """
        up_map = located.T_map_body.R @ -found.gravity / np.linalg.norm(found.gravity)
        tilt = np.array([up_map[1], -up_map[0]])
        P, rows = located.covariance, np.array([3, 4])
        sigma_rad = PRIOR_PER_TILT_SIGMA * self._sigma_tilt_rad(found)
        S = P[np.ix_(rows, rows)] + sigma_rad**2 * np.eye(len(rows))
        K = np.linalg.solve(S, P[rows]).T
        if tilt @ np.linalg.solve(S, tilt) > chdtri(len(rows), 1.0 - TILT_PROBABILITY):
            raise InsufficientEvidence(
                f"{located.inliers} landmarks of the map fit a pose whose vertical is "
                f"{np.rad2deg(np.linalg.norm(tilt)):.1f} degrees from gravity's"
            )
        step, T = K @ tilt, located.T_map_body
        return PoseEstimate(stamp_ns, Pose(so3_exp(step[3:]) @ T.R, T.t + step[:3]), symmetrise(P - K @ S @ K.T))
