# SPDX-License-Identifier: Apache-2.0
"""Folders of images in one or several bands, for the feature study."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.messages import AS_THE_SENSOR_LAY
from uav_vslam.errors import ConfigError

Image = NDArray[np.generic]
SUFFIXES = {".bmp", ".jpg", ".jpeg", ".pgm", ".png", ".tif", ".tiff"}


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a set's images are, and which of them are compared.

    Attributes:
        bands: pattern of the files of each band, in the order of their names.
        spacings: distances from the first image, in images.
        usual: the default distance at which methods are compared.
        cross: the distance at which bands are compared, None for a set of one band.
        still: the camera is stationary and the bands are aligned, up to a shift.
    """

    bands: dict[str, str]
    spacings: tuple[int, ...] = (1, 2, 3, 5, 9)
    usual: int = 1
    cross: int | None = None
    still: bool = False


LAYOUTS = {
    # The first visible image is shifted by two pixels against all others.
    "tno_nato_camp": Layout(
        {"visible": "visual/*.bmp", "thermal": "thermal/*.bmp"}, tuple(range(1, 10)), usual=4, cross=4, still=True
    ),
    "odm_garfield": Layout({"visible": "*_rgb.jpg", "near infrared": "*_nir.png"}, (1, 2), cross=0),
    "odm_caliterra": Layout({"visible": "*.jpg"}, (1, 2, 3, 5)),
}


def files_of(layout: Layout, folder: Path) -> dict[str, dict[int, Path]]:
    """Return, per band, the first image and those at the layout's distances that exist, by number.

    Raises:
        ConfigError: a band has fewer than two images.
    """
    found = {}
    for band, pattern in layout.bands.items():
        files = sorted(file for file in folder.glob(pattern) if file.suffix.lower() in SUFFIXES)
        if len(files) < 2:
            raise ConfigError(f"{folder} holds {len(files)} images like {pattern}; two or more are needed")
        wanted = {0, layout.usual, layout.cross or 0, *layout.spacings}
        found[band] = {number: files[number] for number in sorted(wanted) if number < len(files)}
    return found


def read_image(path: Path) -> Image:
    """Return a file's image, (H, W) or (H, W, 3) BGR, at its own bit depth.

    Raises:
        ConfigError: it can't be read.
    """
    try:
        image = cv2.imread(str(path), AS_THE_SENSOR_LAY | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    except cv2.error:  # of a size beyond OpenCV's limits
        image = None
    if image is None:
        raise ConfigError(f"{path} can't be read as an image")
    return np.asarray(image)


def shift_between(first: Image, second: Image) -> NDArray[np.float64]:
    """Return the (2,) shift [px] that aligns one image of a still camera with another, by phase correlation."""
    size = first.shape[1], first.shape[0]
    shift, _ = cv2.phaseCorrelate(_zero_mean(first), _zero_mean(second), cv2.createHanningWindow(size, cv2.CV_32F))
    return np.array(shift)


def _zero_mean(image: Image) -> NDArray[np.float32]:
    """Return a grey image minus its mean, which would correlate through the window alone."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    plain = np.asarray(grey, np.float32)
    return plain - np.float32(plain.mean())
