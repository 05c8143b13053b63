# SPDX-License-Identifier: Apache-2.0
"""Pictures inside the page, made small enough."""

import base64
import io
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from uav_vslam.errors import UavVslamError
from uav_vslam.report.page.html import Markup, tag, void

WIDTHS_PX = (2800, 2200, 1800, 1400, 1000, 700, 480)  # tried one after another until the file is small enough
DRAWING_WIDTHS_PX = (1400, 1000, 700, 480, 320, 200)
QUALITY = 82
TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


def photograph(path: Path, most_bytes: int) -> tuple[str, tuple[int, int]]:
    """Return a picture as the address of a JPEG of at most so many bytes, the widest that is; and its size [px].

    Transparent parts become white. The narrowest is returned even if it is larger.
    """
    whole = opened(path)
    content, size = b"", whole.size
    for width in WIDTHS_PX:
        picture = _narrowed(whole, width)
        content, size = _encoded(picture, "JPEG", quality=QUALITY), picture.size
        if len(content) <= most_bytes:
            break
    return address(content, "image/jpeg"), size


def drawing(path: Path, most_bytes: int) -> tuple[str, tuple[int, int]]:
    """Return a plot as the address of its PNG; one above so many bytes gets 128 colours, then is made narrower."""
    content, picture = path.read_bytes(), opened(path)
    for width in (picture.width, *(width for width in DRAWING_WIDTHS_PX if width < picture.width)):
        if len(content) <= most_bytes:
            break
        picture = _narrowed(picture, width)
        content = _encoded(picture.quantize(128), "PNG", optimize=True)
    return address(content, "image/png"), picture.size


def figure(source: tuple[str, tuple[int, int]], text: str) -> Markup:
    """Return a picture with its caption, which a script lets the reader move and enlarge."""
    where, (width, height) = source
    image = void("img", src=where, alt=text, width=str(width), height=str(height), loading="lazy")
    keys = f"{text}; arrow keys, + and - move it"
    held = tag("div", image, data_pan=True, class_="pan", tabindex="0", role="group", aria_label=keys)
    return tag("figure", held, tag("figcaption", text))


def address(content: bytes, kind: str) -> str:
    """Return a data: address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def opened(path: Path) -> Image.Image:
    """Return a picture in RGB.

    Raises:
        UavVslamError: the file is no picture.
    """
    Image.MAX_IMAGE_PIXELS = None  # an orthomosaic is large
    try:
        with Image.open(path) as image:
            if image.mode in ("RGBA", "LA", "P"):
                white = Image.new("RGBA", image.size, "white")
                return Image.alpha_composite(white, image.convert("RGBA")).convert("RGB")
            return image.convert("RGB")
    except (UnidentifiedImageError, OSError) as error:
        raise UavVslamError(f"{path} is no picture: {error}; remove it or draw it again") from None


def _narrowed(image: Image.Image, width: int) -> Image.Image:
    if image.width <= width:
        return image
    return image.resize((width, max(1, round(image.height * width / image.width))), Image.Resampling.LANCZOS)


def _encoded(image: Image.Image, kind: str, **options: int | bool) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()
