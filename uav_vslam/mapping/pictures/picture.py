# SPDX-License-Identifier: Apache-2.0
"""One picture of a folder: its file, size and what its metadata say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from uav_vslam.errors import PictureError
from uav_vslam.mapping.opacity import Mask
from uav_vslam.vision.images import stretched, to_bgr8

Image = NDArray[np.uint8]

HALF_OPAQUE = 128
TIFF, ORIENTATION, FIRST_ACROSS = {".tif", ".tiff"}, 0x0112, 5  # orientations from there on swap width and height


@dataclass(frozen=True, slots=True)
class Geodetic:
    """A WGS 84 position: degrees, and height above the ellipsoid or the sea, whichever the camera recorded [m]."""

    latitude_deg: float
    longitude_deg: float
    height_m: float

    @property
    def unset(self) -> bool:
        """0, 0 is what receivers write that know no position yet."""
        return self.latitude_deg == 0.0 and self.longitude_deg == 0.0


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
        levels: values of a 16-bit image that become black and white; None stretches each image by its own range.
        has_alpha: parts of the image may be transparent.
    """

    path: Path
    width: int
    height: int
    turned: bool
    camera: str
    focal_px: float | None
    time_s: float | None
    position: Geodetic | None
    levels: tuple[float, float] | None = None
    has_alpha: bool = False

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    def read(self) -> Image:
        """Return the (H, W, 3) BGR image as the sensor lay: orientation flags, which differ by mood, are ignored.

        But those of TIFF count, whose readers know no other way; sizes and `turned` are for the image so read.

        Raises:
            PictureError: the file is damaged or has another size than before.
            InvalidMessage: its pixels are of a kind that is not supported.
        """
        stored = self.stored()
        if self.levels is not None and stored.dtype == np.uint16:
            stored = stretched(stored, *self.levels)
        return np.ascontiguousarray(to_bgr8(stored))

    def stored(self) -> NDArray[np.generic]:
        """Return the image as `read` does, but in grey or BGR and with 8 or 16 bits as in the file.

        Raises:
            PictureError: the file is damaged or has another size than before.
        """
        return self._lying(_decoded(self.path))

    def opaque(self) -> Mask | None:
        """Return (H, W) where the image is not transparent; None if that is everywhere. Errors as of `stored`."""
        alpha = self._lying(_by_pillow(self.path, alpha=True)) if self.has_alpha else None
        return None if alpha is None or alpha.min() >= HALF_OPAQUE else alpha >= HALF_OPAQUE

    def _lying(self, stored: NDArray[Any] | None) -> NDArray[Any]:
        if stored is None:
            raise PictureError(f"{self.path} can't be decoded; is it damaged? Remove it from the folder")
        image = np.rot90(stored) if self.turned else stored
        if image.shape[:2] != (self.height, self.width):
            raise PictureError(f"{self.path} is {image.shape[1]}x{image.shape[0]}, not {self.width}x{self.height} px")
        return np.ascontiguousarray(image)


def _decoded(path: Path) -> NDArray[np.generic] | None:
    """Return the grey or BGR image of a file, 8 or 16 bits; None if it can't be decoded."""
    if path.suffix.lower() in TIFF and _lies_across(path):
        return _by_pillow(path)  # OpenCV 4 fails: it turns the image, and finds its size to be another than promised
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return cv2.imread(str(path), flags)


def _lies_across(path: Path) -> bool:
    """Return whether a TIFF file's orientation swaps width and height."""
    try:
        with PillowImage.open(path) as image:
            return int(image.getexif().get(ORIENTATION, 1)) >= FIRST_ACROSS
    except (OSError, SyntaxError, ValueError):
        return False  # OpenCV may know better


def _by_pillow(path: Path, *, alpha: bool = False) -> NDArray[np.generic] | None:
    """Return the grey or BGR image of a file, or its (H, W) opacity; None if it can't be decoded."""
    try:
        # By path, Pillow maps an uncompressed grey file into memory with width and height swapped.
        with path.open("rb") as file, PillowImage.open(file) as image:
            image.load()  # turns it
            if alpha:
                return np.array(image.convert("RGBA").getchannel("A"))
            if image.mode in {"L", "I;16"}:
                return np.array(image)
            return np.array(image.convert("RGB"))[..., ::-1]
    except (OSError, SyntaxError, ValueError):
        return None
