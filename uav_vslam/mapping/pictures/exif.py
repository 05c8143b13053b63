# SPDX-License-Identifier: Apache-2.0
"""What a picture's EXIF data tell of its focal length, time and position; the tags are those of EXIF 2.32."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from PIL import Image as PillowImage

from uav_vslam.mapping.pictures.picture import Geodetic

EXIF_IFD, GPS_IFD = 0x8769, 0x8825
MAKE, MODEL, DATE_TIME = 0x010F, 0x0110, 0x0132
DATE_TIME_ORIGINAL, SUBSECONDS = 0x9003, 0x9291
FOCAL_MM, FOCAL_35MM = 0x920A, 0xA405
PLANE_X_RESOLUTION, PLANE_UNIT, PIXELS_X, PIXELS_Y = 0xA20E, 0xA210, 0xA002, 0xA003
LATITUDE_REF, LATITUDE, LONGITUDE_REF, LONGITUDE, ALTITUDE_REF, ALTITUDE = 1, 2, 3, 4, 5, 6
MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}  # of the focal plane's resolution: inch, cm, mm
FILM_DIAGONAL_MM = 43.2666  # of 36 x 24 mm
CLOCK_FORMAT = "%Y:%m:%d %H:%M:%S"

Tags = Mapping[int, Any]


@dataclass(frozen=True, slots=True)
class Metadata:
    """EXIF data as far as they are there.

    `focal_px` is for the image's stored width and height; `without_altitude`: GPS has a place, but no altitude.
    """

    camera: str
    focal_px: float | None
    time_s: float | None
    position: Geodetic | None
    without_altitude: bool


def metadata_of(image: PillowImage.Image) -> Metadata:
    """Return the metadata of an opened image; whatever is missing or malformed is None."""
    main = image.getexif()
    details, gps = main.get_ifd(EXIF_IFD), main.get_ifd(GPS_IFD)
    names = [_text(main.get(tag)) for tag in (MAKE, MODEL)]
    return Metadata(
        " ".join(filter(None, names)),
        focal_px(details, image.size),
        clock_s(details.get(DATE_TIME_ORIGINAL) or main.get(DATE_TIME), details.get(SUBSECONDS)),
        position_of(gps),
        _number(gps.get(ALTITUDE)) is None and position_of({**gps, ALTITUDE: 0.0}) is not None,
    )


def focal_px(tags: Tags, size: tuple[int, int]) -> float | None:
    """Return the focal length [px], by the focal plane's resolution, or else by the 35 mm equivalent.

    Args:
        tags: of the EXIF directory.
        size: width and height of the image [px], which may have been shrunk since.
    """
    focal_mm, resolution = _number(tags.get(FOCAL_MM)), _number(tags.get(PLANE_X_RESOLUTION))
    sides = [side for tag in (PIXELS_X, PIXELS_Y) if (side := _number(tags.get(tag)))]
    original = max(sides, default=float(max(size)))  # the picture may have been turned since
    if focal_mm and resolution:
        per_mm = resolution / MM_PER_UNIT.get(tags.get(PLANE_UNIT, 2), 25.4)
        return focal_mm * per_mm * max(size) / original
    film_mm = _number(tags.get(FOCAL_35MM))
    return film_mm / FILM_DIAGONAL_MM * float(size[0] ** 2 + size[1] ** 2) ** 0.5 if film_mm else None


def clock_s(text: Any, subseconds: Any = None) -> float | None:
    """Return the seconds since 1970 of an EXIF time, taken as UTC; None if there is none."""
    try:
        whole = datetime.strptime(_text(text), CLOCK_FORMAT).replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    digits = _text(subseconds)
    return whole + (float(f"0.{digits}") if digits.isdecimal() else 0.0)


def position_of(tags: Tags) -> Geodetic | None:
    """Return the position of a GPS directory; None unless latitude, longitude and altitude are there and set."""
    latitude, longitude = _degrees(tags.get(LATITUDE)), _degrees(tags.get(LONGITUDE))
    altitude = _number(tags.get(ALTITUDE))
    if latitude is None or longitude is None or altitude is None:
        return None
    below = tags.get(ALTITUDE_REF) in (1, b"\x01")
    position = Geodetic(
        -latitude if _text(tags.get(LATITUDE_REF)).upper() == "S" else latitude,
        -longitude if _text(tags.get(LONGITUDE_REF)).upper() == "W" else longitude,
        -altitude if below else altitude,
    )
    return None if position.unset else position


def _text(value: Any) -> str:
    """Return a tag's text without what fills its field up; empty if it is not there."""
    return str(value or "").strip("\0 ")


def _number(value: Any) -> float | None:
    """Return a finite number of a tag's value, None if it is none; 0 / 0 stands for "unknown"."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if abs(number) < float("inf") else None


def _degrees(value: Any) -> float | None:
    try:
        parts = [_number(part) for part in value]
    except TypeError:
        return None
    if len(parts) != 3 or None in parts:
        return None
    return sum(part / 60.0**k for k, part in enumerate(parts) if part is not None)
