# SPDX-License-Identifier: Apache-2.0
"""Rigs and ray-traced stereo pairs of textured planes with known depth in every pixel."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import StereoFrame

Array = NDArray[np.float64]

FRONT_BACK_CAMERA = PinholeCamera(1280, 960, 1642.0, 1642.0, 640.0, 480.0)
FRONT_BACK_RIG = StereoRig(  # like Kagaru's: the disparity is along v, and the cameras converge by half a degree
    FRONT_BACK_CAMERA,
    FRONT_BACK_CAMERA,
    Pose.identity(),
    Pose(so3_exp([0.01, -0.004, 0.006]), np.array([0.0, 0.776, 0.0])),
)
DISTORTED_CAMERA = PinholeCamera(
    752, 480, 458.654, 457.296, 367.215, 248.375, np.array([-0.28340811, 0.07395907, 0.00019359, 1.76e-05, 0.0])
)
DISTORTED_RIG = StereoRig(
    DISTORTED_CAMERA, DISTORTED_CAMERA, Pose.identity(), Pose(so3_exp([0.01, -0.014, 0.006]), np.array([0.11, 0, 0]))
)


@dataclass(frozen=True)
class Plane:
    """A textured plane: a point and the normal in the left camera's frame, and the half size [m], inf for unbounded."""

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    m_per_px: float
    half_size_m: float = np.inf


@dataclass(frozen=True)
class Scene:
    """A rendered pair and the depth [m] of every raw left pixel."""

    rig: StereoRig
    frame: StereoFrame
    depth_left: Array

    def wrong(self, pixels: NDArray[np.floating], tolerance_px: float = 3.0) -> NDArray[np.bool_]:
        """Return which (N, 4) undistorted stereo pixels are farther than the tolerance from the truth."""
        return np.linalg.norm(self.right_error(pixels), axis=1) > tolerance_px

    def right_error(self, pixels: NDArray[np.floating]) -> Array:
        """Return (N, 2) right pixel minus the true image of the left pixel's surface point [px]."""
        z = np.asarray(pixels, float)
        columns, rows = np.rint(self.rig.left.distort(z[:, :2])).astype(int).T
        depth = self.depth_left[rows.clip(0, self.rig.left.height - 1), columns.clip(0, self.rig.left.width - 1)]
        points_right = self.rig.T_right_left.apply(self.rig.left.bearings(z[:, :2]) * depth[:, None])
        return z[:, 2:] - self.rig.right.project(points_right)


def make_texture(rng: np.random.Generator, size: int = 2048) -> NDArray[np.float32]:
    """Return noise of all scales, grey 0..255."""
    total = np.zeros((size, size), np.float32)
    for octave in range(7):
        coarse = rng.standard_normal((size >> octave, size >> octave)).astype(np.float32)
        total += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC) * 1.5**octave
    return np.asarray(128 + 45 * (total - total.mean()) / total.std(), np.float32)


def render(
    camera: PinholeCamera, T_left_cam: Pose, planes: list[Plane], texture: NDArray[np.float32]
) -> tuple[Array, Array]:
    """Return the (H, W) image and each pixel's depth [m] along the optical axis."""
    rows, columns = np.mgrid[: camera.height, : camera.width].astype(float)
    rays_left = camera.bearings(camera.undistort(np.stack([columns, rows], -1))) @ T_left_cam.R.T
    image, depth = np.zeros(rows.shape), np.full(rows.shape, np.inf)
    for plane in planes:
        normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
        along = np.cross(normal, [0.3, 1.0, 0.2])
        along /= np.linalg.norm(along)
        hit = ((np.array(plane.point) - T_left_cam.t) @ normal) / (rays_left @ normal)
        offset = T_left_cam.t + hit[..., None] * rays_left - plane.point
        x, y = offset @ along, offset @ np.cross(normal, along)
        where = (np.stack([x, y]) / plane.m_per_px + texture.shape[0] / 2).astype(np.float32)
        value = cv2.remap(texture, where[0], where[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        seen = (hit > 0) & (hit < depth) & (np.maximum(abs(x), abs(y)) < plane.half_size_m)
        image, depth = np.where(seen, value, image), np.where(seen, hit, depth)
    return image, depth


def make_scene(rig: StereoRig, planes: list[Plane], rng: np.random.Generator) -> Scene:
    """Render both cameras with two grey levels of noise."""
    texture = make_texture(rng)
    left, depth_left = render(rig.left, Pose.identity(), planes, texture)
    right, _ = render(rig.right, rig.T_body_left.inverse() @ rig.T_body_right, planes, texture)
    noisy = [np.clip(np.rint(image + rng.normal(0, 2.0, image.shape)), 0, 255) for image in (left, right)]
    return Scene(rig, StereoFrame(1, noisy[0].astype(np.uint8), noisy[1].astype(np.uint8)), depth_left)


@pytest.fixture(scope="session")
def flight_scene() -> Scene:
    """Slanted ground 70 m below, with the disparity along v."""
    ground = Plane((0.0, 0.0, 70.0), (0.05, 0.02, -1.0), 0.05)
    return make_scene(FRONT_BACK_RIG, [ground], np.random.default_rng(1))


@pytest.fixture(scope="session")
def indoor_scene() -> Scene:
    """A room with eight boards, seen by a rig with distortion and converging cameras: many depth discontinuities."""
    rng = np.random.default_rng(2)
    room = [Plane((0, 0, 5.0), (0.1, 0, -1), 0.006), Plane((0, 1.2, 0), (0, -1, 0.02), 0.005)]
    boards = [
        Plane(
            (rng.uniform(-2, 2), rng.uniform(-1, 1), rng.uniform(1.2, 4)),
            (rng.normal(0, 0.4), rng.normal(0, 0.4), -1.0),
            0.003,
            rng.uniform(0.1, 0.5),
        )
        for _ in range(8)
    ]
    return make_scene(DISTORTED_RIG, room + boards, rng)


@pytest.fixture(params=["flight_scene", "indoor_scene"])
def scene(request: pytest.FixtureRequest) -> Scene:
    """Each of the scenes."""
    found: Scene = request.getfixturevalue(request.param)
    return found


@pytest.fixture(scope="session")
def texture_image() -> Callable[[int, int], NDArray[np.uint8]]:
    """Return a function for (height, width) textured grey images."""
    texture = make_texture(np.random.default_rng(3), 512)
    return lambda height, width: np.clip(np.rint(texture[:height, :width]), 0, 255).astype(np.uint8)
