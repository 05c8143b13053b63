# SPDX-License-Identifier: Apache-2.0
"""Adjusted pictures as views of the map: undistorted images with their poses."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.pictures.lens import camera_of
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.procedure import Adjusted
from uav_vslam.mapping.undistortion import filling_zoom
from uav_vslam.mapping.view import Image, View

NAME = "pictures"
FADE_PX = 0.5  # how far beyond the outermost pixels' centres an image goes
EDGE_PX = 3  # beside what is transparent, whose colour interpolation mixes in
STRIP_ROWS = 256


class PictureViews:
    """Yields the views of a folder's pictures, one image in memory at a time."""

    def __init__(self, pictures: Sequence[Picture], adjusted: Adjusted) -> None:
        """Prepare; images are read when they are needed."""
        self._pictures, self._adjusted = pictures, adjusted
        self._lenses: dict[int, tuple[PinholeCamera, tuple[Image, Image]]] = {}

    def __iter__(self) -> Iterator[View]:
        return (self.view(int(number)) for number in self._adjusted.used)

    def pose(self, number: int) -> Pose:
        """Return T_map_cam of a picture."""
        scene = self._adjusted.scene
        return Pose(scene.R_cam_map[number].T.copy(), scene.centres[number].copy())

    def camera(self, number: int) -> PinholeCamera:
        """Return the camera of a picture, with its distortion."""
        scene, picture = self._adjusted.scene, self._pictures[number]
        return camera_of(scene.lenses[scene.lens_of[number]], picture.width, picture.height)

    def view(self, number: int) -> View:
        """Read and undistort a picture.

        Raises:
            PictureError: it can't be read any more.
        """
        picture, lens = self._pictures[number], int(self._adjusted.scene.lens_of[number])
        opaque = picture.opaque()
        if lens not in self._lenses:
            self._lenses[lens] = undistortion(self.camera(number))
        ideal, maps = self._lenses[lens]
        image = cv2.remap(picture.read(), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        stamp_ns = round((picture.time_s or 0.0) * 1e9) + number  # clocks are coarse; a stamp names a view
        if opaque is not None:
            inside = cv2.erode(opaque.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=EDGE_PX)
            opaque = cv2.remap(inside, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0
        return View(NAME, stamp_ns, ideal, self.pose(number), np.asarray(image, np.uint8), opaque)


def undistortion(camera: PinholeCamera) -> tuple[PinholeCamera, tuple[Image, Image]]:
    """Return a camera without distortion, whose image is all within the distorted one, and OpenCV's maps to it."""
    zoom = max(filling_zoom(camera, pixels, border_px=FADE_PX) for pixels in _strips(camera))
    ideal = PinholeCamera(camera.width, camera.height, zoom * camera.fx, zoom * camera.fy, camera.cx, camera.cy)
    raw = np.concatenate(
        [camera.distort(camera.project(ideal.bearings(pixels))).astype(np.float32) for pixels in _strips(camera)]
    )
    maps = cv2.convertMaps(raw[..., 0], raw[..., 1], cv2.CV_16SC2)
    return ideal, (np.asarray(maps[0]), np.asarray(maps[1]))


def _strips(camera: PinholeCamera) -> Iterator[NDArray[np.float64]]:
    """Yield the (rows, W, 2) pixels of an image from above: all together would take a gigabyte."""
    for top in range(0, camera.height, STRIP_ROWS):
        u, v = np.meshgrid(np.arange(camera.width), np.arange(top, min(top + STRIP_ROWS, camera.height)))
        yield np.stack([u, v], axis=-1).astype(float)
