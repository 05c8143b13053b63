# SPDX-License-Identifier: Apache-2.0
"""Local east-north-up coordinates to WGS 84 and back, by PROJ (EPSG method 9837, geographic/topocentric)."""

from dataclasses import dataclass

import numpy as np
import pyproj
from numpy.typing import ArrayLike, NDArray

from uav_vslam.errors import ConfigError
from uav_vslam.geometry.rotation import rotation_from_rpy

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Datum:
    """Where the map's origin is, and how its axes lie.

    Attributes:
        latitude_deg, longitude_deg: of the origin, WGS 84 [deg].
        altitude_m: of the origin [m]; altitudes come out above the same reference, ellipsoid or sea level.
        yaw_deg: of the map's x axis from east, counter-clockwise [deg].
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        limits = {"latitude": (self.latitude_deg, 90), "longitude": (self.longitude_deg, 180)}
        limits["yaw"] = (self.yaw_deg, 360)
        for name, (value, largest) in limits.items():
            if not abs(value) <= largest:
                raise ConfigError(f"{name} {value:g} of the datum is not within ±{largest} degrees; give LAT LON ALT")
        if not np.isfinite(self.altitude_m):
            raise ConfigError(f"altitude {self.altitude_m:g} of the datum must be finite")

    def figures(self) -> dict[str, float]:
        """Return what `map.json` holds of it; the yaw only of a map that is turned."""
        place = {"latitude_deg": self.latitude_deg, "longitude_deg": self.longitude_deg, "height_m": self.altitude_m}
        return place | ({"yaw_deg": self.yaw_deg} if self.yaw_deg else {})


def to_geodetic(positions: Array, datum: Datum) -> Array:
    """Return (N, 3) longitude, latitude [deg] and altitude [m] of (N, 3) map positions [m]."""
    return np.stack(_to_wgs84(datum).transform(*(_R_enu_map(datum) @ positions.T)), axis=1)


def from_geodetic(points: Array, datum: Datum) -> Array:
    """Return (N, 3) map positions [m] of (N, 3) longitude, latitude [deg] and altitude [m]."""
    longitude, latitude, altitude = points.T
    east_north_up = _to_wgs84(datum).transform(longitude, latitude, altitude, direction="INVERSE")
    return np.asarray(np.stack(east_north_up, axis=1) @ _R_enu_map(datum))


def within_180(degrees: ArrayLike) -> Array:
    """Return angles in [-180, 180) degrees; those that are there already stay as they are."""
    degrees = np.asarray(degrees, dtype=float)
    return np.where(np.abs(degrees) < 180.0, degrees, (degrees + 180.0) % 360.0 - 180.0)


def _R_enu_map(datum: Datum) -> Array:
    return rotation_from_rpy(0.0, 0.0, np.deg2rad(datum.yaw_deg))


def _to_wgs84(datum: Datum) -> pyproj.Transformer:
    origin = f"+lat_0={datum.latitude_deg:.12f} +lon_0={datum.longitude_deg:.12f} +h_0={datum.altitude_m:.6f}"
    return pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 {origin} "
        "+step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
