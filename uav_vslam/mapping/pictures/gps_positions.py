# SPDX-License-Identifier: Apache-2.0
"""Where the pictures were taken by GPS, in metres around their median."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum, from_geodetic, within_180
from uav_vslam.mapping.pictures.picture import Picture

Array = NDArray[np.float64]


def local_positions(pictures: Sequence[Picture]) -> tuple[Array, Datum | None]:
    """Return (N, 3) east, north, up of the pictures by GPS [m], NaN where unknown, and the origin; None without any."""
    known = [k for k, picture in enumerate(pictures) if picture.position is not None]
    positions = np.full((len(pictures), 3), np.nan)
    geodetic = [(p.longitude_deg, p.latitude_deg, p.height_m) for picture in pictures if (p := picture.position)]
    if not known:
        return positions, None
    longitude, latitude, height = np.median(_unwrapped(np.array(geodetic)), axis=0)
    datum = Datum(float(latitude), float(within_180(longitude)), float(height))
    positions[known] = from_geodetic(np.array(geodetic), datum)
    return positions, datum


def _unwrapped(geodetic: Array) -> Array:
    """Return (N, 3) longitude, latitude, height with longitudes near the first: they jump at the antimeridian."""
    unwrapped = geodetic.copy()
    unwrapped[:, 0] = geodetic[0, 0] + within_180(geodetic[:, 0] - geodetic[0, 0])
    return unwrapped


def without_repeats(positions: Array) -> Array:
    """Return (N, 3) positions, NaN for those that repeat an earlier one: a receiver that is stuck gives no others.

    If half of them were equal, the similarity that maps all pictures to one point would fit best.
    """
    known = np.flatnonzero(np.isfinite(positions).all(axis=1))
    _, first = np.unique(positions[known], axis=0, return_index=True)
    distinct = np.full_like(positions, np.nan)
    distinct[known[first]] = positions[known[first]]
    return distinct
