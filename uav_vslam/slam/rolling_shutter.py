# SPDX-License-Identifier: Apache-2.0
"""Cameras that expose one row after another: where their points would be if all rows were exposed at once.

In a readout of 20 ms, say, a vehicle flies 0.4 m and turns by 5 mrad: the last row is 4 pixels off. Motion and depth
are known well enough to undo that to a hundredth, by a speed known to 0.1 m/s, the rates, and stereo depths.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuIncrement, NavState, StereoFeatures

Array = NDArray[np.float64]

FAR_M = 1e4  # depth of points without one: only the rotation moves them


def exposed_at_once(
    features: StereoFeatures, nav: NavState, increment: ImuIncrement | None, *, rig: StereoRig, readout_s: float
) -> StereoFeatures:
    """Return stereo points where all rows would show them if they were exposed at the stamp, as the middle one is.

    Of a first frame, without rates, there are none.

    Args:
        features: undistorted pixels.
        nav: state at the stamp.
        increment: motion up to there.
        rig: calibration.
        readout_s: time from the exposure of the first row to that of the last [s]; 0: the features are returned.
    """
    if readout_s == 0.0:
        return features
    if increment is None:
        return StereoFeatures.empty(features.stamp_ns)
    pixels = pixels_at_once(
        features.pixels.astype(float), nav, Turning.at_end(increment, nav), rig=rig, readout_s=readout_s
    )
    return dataclasses.replace(features, pixels=pixels.astype(features.pixels.dtype))


def pixels_at_once(pixels: Array, nav: NavState, turning: Turning, *, rig: StereoRig, readout_s: float) -> Array:
    """Return (N, 4) stereo pixels as `exposed_at_once` does, given how the vehicle turns about the stamp."""
    shares = [below_middle(rig.left, pixels[:, :2]), below_middle(rig.right, pixels[:, 2:])]
    later_s = readout_s * np.column_stack(shares)[..., None]
    points = rig.triangulate(pixels)
    far = ~np.isfinite(points[:, 2])
    points[far] = FAR_M * rig.left.bearings(pixels[far, :2])
    moving = velocities_left(points[:, None], nav, turning.rate_map + 0.5 * later_s * turning.slope_map, rig)
    flow = np.einsum("ncki,nci->nck", rig.project_jacobian(points).reshape(-1, 2, 2, 3), moving)
    return np.asarray(pixels - (flow * later_s).reshape(-1, 4))


def below_middle(camera: PinholeCamera, pixels: Array) -> Array:
    """Return (N,) how far below the middle of the image its lens shows undistorted pixels, as a share of its height."""
    return np.asarray((camera.distort(pixels)[:, 1] + 0.5) / camera.height - 0.5)


def velocities_left(points_left: Array, nav: NavState, rates_map: Array, rig: StereoRig) -> Array:
    """Return (..., 3) velocities in the left camera's frame of points that rest on the ground [m/s].

    Args:
        points_left: (..., 3) where they are [m].
        nav: state of the vehicle.
        rates_map: (..., 3) its angular rates [rad/s].
        rig: calibration.
    """
    R_left_map = (nav.T_map_body.R @ rig.T_body_left.R).T
    of_camera = nav.v_map + np.cross(rates_map, nav.T_map_body.R @ rig.T_body_left.t)
    return np.asarray(-of_camera @ R_left_map.T - np.cross(rates_map @ R_left_map.T, points_left))
