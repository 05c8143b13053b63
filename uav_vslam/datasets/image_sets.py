# SPDX-License-Identifier: Apache-2.0
"""Folders of images, in one band or several, as the study of features wants them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import ConfigError

Image = NDArray[np.generic]
SUFFIXES = {".bmp", ".jpg", ".jpeg", ".pgm", ".png", ".tif", ".tiff"}


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a set's images are, and which of them are worth comparing.

    Attributes:
        bands: pattern of the files of each band, in the order of their names.
        spacings: distances from the first image, in images.
        usual: the distance at which methods are compared.
        cross: the distance at which bands are compared, None for a set of one band.
        still: the camera stands still and the bands are aligned, so that points stay where they are but for a shift.
    """

    bands: dict[str, str]
    spacings: tuple[int, ...] = (1, 2, 3, 5, 9)
    usual: int = 1
    cross: int | None = None
    still: bool = False


LAYOUTS = {
    # The first visible image lies two pixels beside all the others.
    "tno_nato_camp": Layout(
        {"visible": "visual/*.bmp", "thermal": "thermal/*.bmp"}, tuple(range(1, 10)), usual=4, cross=4, still=True
    ),
    "odm_garfield": Layout({"visible": "*_rgb.jpg", "near infrared": "*_nir.png"}, (1, 2), cross=0),
    "odm_caliterra": Layout({"visible": "*.jpg"}, (1, 2, 3, 5)),
}


def files_of(layout: Layout, folder: Path) -> dict[str, dict[int, Path]]:
    """Return each band's first image, and those at the layout's distances as far as there are any, by number.

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
    """Return a file's image, (H, W) or (H, W, 3) BGR, of as many bits as it has.

    Raises:
        ConfigError: it can't be read.
    """
    image = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if image is None:
        raise ConfigError(f"{path} can't be read as an image")
    return np.asarray(image)


def shift_between(first: Image, second: Image) -> NDArray[np.float64]:
    """Return the (2,) way [px] that one image of a still camera must be moved to lie on another: phase correlation."""
    size = first.shape[1], first.shape[0]
    shift, _ = cv2.phaseCorrelate(_about_zero(first), _about_zero(second), cv2.createHanningWindow(size, cv2.CV_32F))
    return np.array(shift)


def _about_zero(image: Image) -> NDArray[np.float32]:
    """Return an image in grey without its mean, by which a window would correlate with itself."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    plain = np.asarray(grey, np.float32)
    return plain - np.float32(plain.mean())
