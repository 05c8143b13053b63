# SPDX-License-Identifier: Apache-2.0
"""Folders of pictures of simulated ground, with known poses and camera."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.simulation.camera_render import CameraRenderer
from uav_vslam.simulation.terrain import Ground, Relief
from uav_vslam.simulation.texture import GrassTexture

Array = NDArray[np.float64]

R_LEVEL = np.diag([1.0, -1.0, -1.0])  # the image's right is east, its top north
FOCAL_PX, SIZE = 250.0, (320, 240)
HEIGHT_M = 60.0
DISTORTION = np.array([-0.06, 0.02, 0.0, 0.0, 0.0])
DATUM = Datum(48.2, 16.4, 300.0)


@dataclass(frozen=True)
class PictureFlight:
    """Poses over ground, and the camera."""

    poses: tuple[Pose, ...]
    camera: PinholeCamera
    relief_m: float

    @property
    def centres(self) -> Array:
        """(N, 3) true camera centres [m]."""
        return np.array([pose.t for pose in self.poses])

    def names(self) -> list[str]:
        """File names in order."""
        return [f"picture_{k:03d}.png" for k in range(len(self.poses))]


def flight(
    lines: int = 3,
    per_line: int = 5,
    *,
    along_m: float = 20.0,
    across_m: float = 28.0,
    tilt_deg: float = 3.0,
    relief_m: float = 2.0,
    wander_m: float = 1.0,
    oblique_deg: float = 0.0,
    distortion: Array = DISTORTION,
    seed: int = 1,
) -> PictureFlight:
    """Return a flight back and forth; tilt and wander are standard deviations, `oblique_deg` pitches every second."""
    rng = np.random.default_rng(seed)
    poses = []
    for line in range(lines):
        for k in range(per_line):
            forward = line % 2 == 0
            x = along_m * (k if forward else per_line - 1 - k)
            t = np.array([x, across_m * line, HEIGHT_M]) + rng.normal(0.0, wander_m, 3)
            turn = np.array([0.0, oblique_deg * (k % 2), 0.0 if forward else 180.0])
            rpy = np.deg2rad(turn + rng.normal(0.0, tilt_deg, 3))
            poses.append(Pose(rotation_from_rpy(*rpy) @ R_LEVEL, t))
    width, height = SIZE
    camera = PinholeCamera(
        width, height, FOCAL_PX, FOCAL_PX, 0.5 * (width - 1), 0.5 * (height - 1), np.asarray(distortion)
    )
    return PictureFlight(tuple(poses), camera, relief_m)


def render(flown: PictureFlight, *, seed: int = 1) -> list[NDArray[np.uint8]]:
    """Return the flight's grey images."""
    ground = Ground(Relief(flown.relief_m, np.random.default_rng(seed)), GrassTexture(seed, m_per_px=0.1))
    renderer = CameraRenderer(flown.camera, ground)
    rng = np.random.default_rng(seed)
    images = [renderer.render(pose) + rng.normal(0.0, 1.5, SIZE[::-1]) for pose in flown.poses]
    return [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in images]


def write(images: Sequence[NDArray[np.uint8]], names: Sequence[str], folder: Path) -> Path:
    """Write images into a new folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for image, name in zip(images, names, strict=True):
        cv2.imwrite(str(folder / name), image)
    return folder
