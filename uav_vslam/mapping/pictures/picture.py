# SPDX-License-Identifier: Apache-2.0
"""One picture of a folder: its file, size and what its metadata say."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import PictureError
from uav_vslam.vision.images import to_bgr8

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Geodetic:
    """A WGS 84 position: degrees, and height above the ellipsoid or the sea, whichever the camera recorded [m]."""

    latitude_deg: float
    longitude_deg: float
    height_m: float


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on disk.

    Attributes:
        path: its file.
        width, height: of the image as it is used [px].
        turned: the stored image is turned by 90 degrees, so that it lies like the others.
        camera: name of camera and image size, with the nominal focal length where one camera has several; pictures
            with the same name share a focal length and distortion.
        focal_px: focal length by the metadata [px]; None if unknown.
        time_s: seconds since 1970 by the camera's clock, whatever its time zone; None if unknown.
        position: recorded by the camera's GPS; None if unknown.
    """

    path: Path
    width: int
    height: int
    turned: bool
    camera: str
    focal_px: float | None
    time_s: float | None
    position: Geodetic | None

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    def read(self) -> Image:
        """Return the (H, W, 3) BGR image as the sensor lay: orientation flags, which differ by mood, are ignored.

        Raises:
            PictureError: the file is damaged or has another size than before.
        """
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        stored = cv2.imread(str(self.path), flags)
        if stored is None:
            raise PictureError(f"{self.path} can't be decoded; is it damaged? Remove it from the folder")
        image = to_bgr8(np.rot90(stored) if self.turned else stored)
        if image.shape[:2] != (self.height, self.width):
            raise PictureError(f"{self.path} is {image.shape[1]}x{image.shape[0]}, not {self.width}x{self.height} px")
        return np.ascontiguousarray(image)
