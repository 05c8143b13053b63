# SPDX-License-Identifier: Apache-2.0
"""Calibration boards in front of a known stereo rig: corners with noise, and rendered images."""

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from uav_vslam.calibration.boards import Board, Charuco, Corners
from uav_vslam.calibration.bundle import BoardPair
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig

WIDTH, HEIGHT = 480, 360
COEFFICIENTS = {
    "plumb_bob": ([-0.21, 0.06, 0.001, -0.0008, 0.0], [-0.19, 0.05, -0.0006, 0.0011, 0.0]),
    "rational_polynomial": ([0.3, 0.1, 0.001, -0.001, 0.02, 0.5, 0.15, 0.03],) * 2,
    "equidistant": ([0.02, -0.01, 0.004, -0.002], [0.015, -0.008, 0.003, -0.001]),
}
T_LEFT_RIGHT = Pose(so3_exp([0.01, -0.03, 0.02]), np.array([0.12, 0.004, -0.003]))
DEPTHS = 7.0, 13.0  # of boards, in squares
PER_SQUARE = 40  # pixels of the drawn board
SUPERSAMPLING = 3


def rig_of(model: str = "plumb_bob", T_left_right: Pose = T_LEFT_RIGHT) -> StereoRig:
    """Return a rig with lenses of a model; the left camera is the body."""
    left, right = (np.array(values) for values in COEFFICIENTS[model])
    return StereoRig(
        PinholeCamera(WIDTH, HEIGHT, 380.0, 382.0, 243.0, 177.0, left, model),
        PinholeCamera(WIDTH, HEIGHT, 376.0, 377.0, 236.0, 182.0, right, model),
        Pose.identity(),
        T_left_right,
    )


def imaged(rig: StereoRig, points_left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the raw pixels of points of the left camera's frame in both images."""
    right = rig.T_right_left.apply(points_left)
    return rig.left.distort(rig.left.project(points_left)), rig.right.distort(rig.right.project(right))


def grid_of(board: Board) -> np.ndarray:
    """Return the inner corners (N, 3) on the board [m]."""
    x, y = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1) * board.square_m


def poses(board: Board, rig: StereoRig, count: int, rng: np.random.Generator) -> list[Pose]:
    """Return T_left_board of boards that both cameras see as a whole, tilted by up to 35 degrees about two axes."""
    points, found = grid_of(board), []
    centre = points.mean(axis=0)
    border = board.square_m * np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    outline = np.concatenate([points + shift for shift in border])
    while len(found) < count:
        R = so3_exp([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.4, 0.4)])
        ray = [*rng.uniform([-0.5, -0.4], [0.5, 0.4]), 1.0]
        pose = Pose(R, np.array(ray) * rng.uniform(*DEPTHS) * board.square_m - R @ centre)
        pixels = np.concatenate(imaged(rig, pose.apply(outline)))
        if (pixels > 3.0).all() and (pixels < [WIDTH - 3.0, HEIGHT - 3.0]).all():
            found.append(pose)
    return found


def corner_pairs(
    rig: StereoRig, board: Board, count: int, rng: np.random.Generator, *, sigma_px: float
) -> list[BoardPair]:
    """Return pairs of all corners with white noise [px]."""
    points, pairs = grid_of(board), []
    for k, pose in enumerate(poses(board, rig, count, rng)):
        left, right = (
            Corners(points, pixels + rng.normal(0.0, sigma_px, pixels.shape))
            for pixels in imaged(rig, pose.apply(points))
        )
        pairs.append(BoardPair(f"{k:02}", left, right))
    return pairs


def rendered_pair(rig: StereoRig, board: Board, T_left_board: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Return both images of a board on a grey wall."""
    T_right_board = rig.T_right_left @ T_left_board
    return _rendered(rig.left, board, T_left_board), _rendered(rig.right, board, T_right_board)


def _rendered(camera: PinholeCamera, board: Board, T_cam_board: Pose) -> np.ndarray:
    rays = _rays(*_frozen(camera))
    normal = T_cam_board.R[:, 2]
    points_cam = rays * ((normal @ T_cam_board.t) / (rays @ normal))[..., None]
    on_board = (points_cam - T_cam_board.t) @ T_cam_board.R
    # The drawing begins one square and a white border of half a square before the first inner corner.
    place = (on_board[..., :2] / board.square_m + 1.5) * PER_SQUARE - 0.5
    fine = cv2.remap(_drawing(board), *np.moveaxis(place.astype(np.float32), -1, 0), cv2.INTER_LINEAR, borderValue=128)
    image = cv2.GaussianBlur(cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    return np.asarray(image)


def _drawing(board: Board) -> np.ndarray:
    columns, rows = board.columns + 1, board.rows + 1
    if isinstance(board, Charuco):
        plain = board.drawing().generateImage((columns * PER_SQUARE, rows * PER_SQUARE))
    else:
        squares = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 * 255).astype(np.uint8)
        plain = np.kron(squares, np.ones((PER_SQUARE, PER_SQUARE), np.uint8))
    return np.pad(plain, PER_SQUARE // 2, constant_values=255)


def _frozen(camera: PinholeCamera) -> tuple[tuple[float, ...], tuple[float, ...], str]:
    return (camera.fx, camera.fy, camera.cx, camera.cy), tuple(camera.distortion), camera.model


@cache
def _rays(intrinsics: Sequence[float], distortion: Sequence[float], model: str) -> np.ndarray:
    """Return a ray through each subpixel, interpolated between those of the pixels."""
    camera = PinholeCamera(WIDTH, HEIGHT, *intrinsics, np.array(distortion), model)
    pixels = np.stack(np.meshgrid(np.arange(float(WIDTH)), np.arange(float(HEIGHT))), axis=-1)
    fine = WIDTH * SUPERSAMPLING, HEIGHT * SUPERSAMPLING
    return np.asarray(cv2.resize(camera.bearings(camera.undistort(pixels)), fine, interpolation=cv2.INTER_LINEAR))
