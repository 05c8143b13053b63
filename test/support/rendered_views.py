# SPDX-License-Identifier: Apache-2.0
"""Small rendered views of a ground whose height is known, from a straight level flight."""

import functools

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.mapping.view import View
from uav_vslam.simulation.camera_render import CameraRenderer
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.simulation.terrain import Ground, ground_of

CAMERA = PinholeCamera(480, 360, 616.0, 616.0, 240.0, 176.0)
R_MAP_CAM = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # optical y backwards, z down
ALTITUDE_M = 70.0
STEP_M = 3.5


@functools.cache
def ground(relief_m: float = 2.0, seed: int = 1) -> Ground:
    """Return a ground; 0 m is level."""
    return ground_of(Scenario(seed=seed, relief_m=relief_m))


def pose(k: int, *, bank_deg: float = 0.0, origin: tuple[float, float] = (0.0, 0.0)) -> Pose:
    """Return T_map_cam of frame `k`: eastwards, in steps of STEP_M."""
    R = so3_exp([np.deg2rad(bank_deg), 0.0, 0.0]) @ R_MAP_CAM
    return Pose(R, np.array([origin[0] + k * STEP_M, origin[1], ALTITUDE_M]))


@functools.cache
def view(
    k: int,
    relief_m: float = 2.0,
    bank_deg: float = 0.0,
    origin: tuple[float, float] = (0.0, 0.0),
    vehicle: str = "uav1",
) -> View:
    """Return frame `k`; each is rendered once."""
    T_map_cam = pose(k, bank_deg=bank_deg, origin=origin)
    image = CameraRenderer(CAMERA, ground(relief_m), supersample=2).render(T_map_cam)
    noise = np.random.default_rng(k).normal(0.0, 1.0, image.shape)
    grey: NDArray[np.uint8] = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
    return View(vehicle, 1_000_000_000 + 140_000_000 * k, CAMERA, T_map_cam, grey)
