# SPDX-License-Identifier: Apache-2.0
"""Start state of a vehicle in flight over ground that a loaded map covers.

As `in_flight_initializer`, a window of frames gives velocity, gravity and the biases. The first frame is recognised in
the map; then the window's motion, its points and that frame's pose in the map are estimated together. The map's own
errors are in the covariance; gravity corrects the tilt, and must agree with it. Its frame becomes the vehicle's. The
filter starts at the window's last frame, so that it uses no frame again.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import chdtri

from uav_vslam.config import VehicleConfig
from uav_vslam.geometry.rotation import skew
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.preintegrator import advance
from uav_vslam.ins.propagation import ACCEL_BIAS, GYRO_BIAS, NAV_DIM, POSITION, ROTATION, VELOCITY
from uav_vslam.numerics import symmetrise
from uav_vslam.slam import visual_inertial_alignment as of
from uav_vslam.slam.in_flight_initializer import InFlightInitializer, InsufficientEvidence, Start, Window
from uav_vslam.slam.map_points import MapPoints
from uav_vslam.slam.saved_map import SavedMap
from uav_vslam.slam.saved_map.locate import MIN_INLIERS, Located, MapLocator
from uav_vslam.slam.visual_inertial_alignment import MapAlignment, align_in_map
from uav_vslam.types import NavEstimate, NavState

Array = NDArray[np.float64]

TILT_PROBABILITY = 0.9999  # of a correct pose to agree with gravity
POSE_POSITION, POSE_ROTATION = slice(12, 15), slice(15, 18)  # of a `MapAlignment`'s covariance


class MapInitializer(InFlightInitializer):
    """Finds the start in a map; slides on while a frame is not recognised."""

    def __init__(self, rig: StereoRig, config: VehicleConfig, saved: SavedMap) -> None:
        super().__init__(rig, config)
        self._locator = MapLocator(saved, rig, config)

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        super().configure(config)
        self._locator.configure(config)

    def _start(self) -> Start:
        window = self._window()
        estimate = self._start_state(window)
        for _, step in self._buffer[1:]:
            assert step is not None
            estimate = advance(estimate, step, self._config.imu)
        self.dropped += len(self._buffer) - 1
        return Start(estimate, [(self._buffer[-1][0], None)], self._warning(window))

    def _start_state(self, window: Window) -> NavEstimate:
        located = self._locator.locate(window.first)
        if located is None:
            raise InsufficientEvidence(self._locator.reason)
        fit = align_in_map(
            self._rig,
            window.pixels,
            window.views,
            self._map_points(located, window.usable),
            imu=window.imu,
            sigma_px=self._config.backend.sigma_px,
            delay_sigma_s=self._config.rig.time_offset_sigma_s,
        )
        if fit.landmarks < MIN_INLIERS:
            raise InsufficientEvidence(
                f"{located.inliers} landmarks of the map fit the first frame, but only {fit.landmarks} the "
                f"whole window; {MIN_INLIERS} are needed"
            )
        return _levelled(window.first.stamp_ns, fit, located.section.common_covariance(fit.T_map_body.t))

    def _map_points(self, located: Located, usable: NDArray[np.intp]) -> MapPoints:
        """Return the landmarks that fit, by rows of the window's points."""
        pairs = located.pairs[np.isin(located.pairs[:, 1], usable)]
        own = located.section.own_covariances[pairs[:, 0]] + self._config.fusion.floor_sigma_m**2 * np.eye(3)
        rows = np.searchsorted(usable, pairs[:, 1])
        return MapPoints(rows, located.section.positions[pairs[:, 0]], own, located.T_map_body)


def _levelled(stamp_ns: int, fit: MapAlignment, common: Array) -> NavEstimate:
    """Return the state whose roll and pitch agree with gravity.

    The measured vertical is the map frame's, with xi the rotation error and d the error of gravity in body axes:

        R up_body = Exp(-xi) z + R d / g   =>   z = H (xi, d), exactly

    Args:
        stamp_ns: of the first frame [ns].
        fit: pose and motion there.
        common: (6, 6) covariance of the map's common error, of shift [m] and rotation [rad] about the body.

    Raises:
        InsufficientEvidence: they disagree.
    """
    R, g = fit.T_map_body.R, float(np.linalg.norm(fit.gravity))
    up_map = R @ -fit.gravity / g
    tilt = np.array([up_map[1], -up_map[0]])
    P = fit.covariance + block_diag(np.zeros((12, 12)), common)
    H = np.zeros((2, len(P)))
    H[:, POSE_ROTATION] = np.eye(2, 3)
    H[:, of.GRAVITY] = np.array([R[1], -R[0]]) / g
    S = H @ P @ H.T
    if tilt @ np.linalg.solve(S, tilt) > chdtri(len(tilt), 1.0 - TILT_PROBABILITY):
        raise InsufficientEvidence(
            f"{fit.landmarks} landmarks of the map fit a pose whose vertical is "
            f"{np.rad2deg(np.linalg.norm(tilt)):.1f} degrees from gravity's"
        )
    K = np.linalg.solve(S, H @ P).T
    return _nav_estimate(stamp_ns, fit, K @ tilt, symmetrise(P - K @ S @ K.T))


def _nav_estimate(stamp_ns: int, fit: MapAlignment, step: Array, P: Array) -> NavEstimate:
    """Return the state after a step (18,) with covariance P, both in the order of `MapAlignment`."""
    T = fit.T_map_body.moved(step[POSE_POSITION.start : POSE_ROTATION.stop])
    v_map = T.R @ (fit.velocity + step[of.VELOCITY])
    gyro_bias, accel_bias = fit.gyro_bias + step[of.GYRO_BIAS], fit.accel_bias + step[of.ACCEL_BIAS]
    to_nav = np.zeros((NAV_DIM, len(P)))
    to_nav[POSITION, POSE_POSITION] = to_nav[ROTATION, POSE_ROTATION] = np.eye(3)
    to_nav[VELOCITY, of.VELOCITY], to_nav[VELOCITY, POSE_ROTATION] = T.R, -skew(v_map)
    to_nav[GYRO_BIAS, of.GYRO_BIAS] = to_nav[ACCEL_BIAS, of.ACCEL_BIAS] = np.eye(3)
    return NavEstimate(NavState(stamp_ns, T, v_map, gyro_bias, accel_bias), symmetrise(to_nav @ P @ to_nav.T))
