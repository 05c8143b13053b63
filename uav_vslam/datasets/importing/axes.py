# SPDX-License-Identifier: Apache-2.0
"""Axes by letters: "NED", "ENU", "NWU" of a world, "FRD", "FLU" of a body."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import ConfigError

Array = NDArray[np.float64]

WORLD = {"E": (1, 0, 0), "W": (-1, 0, 0), "N": (0, 1, 0), "S": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}
BODY = {"F": (1, 0, 0), "B": (-1, 0, 0), "L": (0, 1, 0), "R": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}


def rotation_to_enu(letters: str) -> Array:
    """Return R_enu_given (3, 3) of world axes such as "NED".

    Raises:
        ConfigError: the letters are not three right-handed axes.
    """
    return _rotation(letters, WORLD, "NED, ENU or NWU")


def rotation_to_flu(letters: str) -> Array:
    """Return R_flu_given (3, 3) of body axes such as "FRD".

    Raises:
        ConfigError: the letters are not three right-handed axes.
    """
    return _rotation(letters, BODY, "FRD, FLU or RFU")


def _rotation(letters: str, axes: dict[str, tuple[int, int, int]], examples: str) -> Array:
    """Return the rotation whose columns are the named axes."""
    if len(letters) == 3 and set(letters) <= set(axes):
        R = np.array([axes[letter] for letter in letters], float).T
        if round(float(np.linalg.det(R))) == 1:
            return R
    raise ConfigError(f"axes {letters!r} are not three right-handed directions; use letters such as {examples}")
