# SPDX-License-Identifier: Apache-2.0
"""What rays meet first in a simulated world, ray by ray: the reference of renderers and height truth."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.camera_render import intersect, lean_bounds
from uav_vslam.simulation.object_render import Hits
from uav_vslam.simulation.solids import Label
from uav_vslam.simulation.terrain import Ground

Array = NDArray[np.float64]


def first_hits(ground: Ground, origin: Array, rays: Array) -> tuple[Array, NDArray[np.uint8]]:
    """Return the (..., 3) points [m] that rays see first, of the ground or what stands on it, and their (...) `Label`.

    Args:
        ground: the world.
        origin: (3,) camera centre in the world [m].
        rays: (..., 3) directions in the world, of any length, pointing down.
    """
    points = intersect(ground.relief, origin, rays)
    flat = points.reshape(-1, 3)
    solids = [] if ground.farm is None or len(flat) == 0 else ground.farm.solids(lean_bounds(origin, flat))
    down = (rays / -rays[..., 2:]).reshape(-1, 3)
    hits = Hits.of_ground(origin[2] - flat[:, 2])
    for k, solid in enumerate(solids):
        hits.cast(k, solid, origin, down, np.arange(len(flat)))
    hit = (hits.which >= 0)[:, None]
    labels = np.array([*(solid.label for solid in solids), Label.GROUND], np.uint8)[hits.which]
    return np.where(hit, origin + hits.drop[:, None] * down, flat).reshape(points.shape), labels.reshape(
        rays.shape[:-1]
    )
