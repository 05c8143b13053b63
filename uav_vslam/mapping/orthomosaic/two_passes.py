# SPDX-License-Identifier: Apache-2.0
"""The mosaic of a finished flight: all gains and what is blurred first, then the picture."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from uav_vslam.mapping.orthomosaic.exposure import Exposure
from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.orthomosaic.key_frames import LEAST_SHARPNESS
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic
from uav_vslam.mapping.orthomosaic.rectification import sharpness_of
from uav_vslam.mapping.orthomosaic.thumbnail import thumbnail
from uav_vslam.mapping.view import View


def blended_mosaic(
    views: Callable[[], Iterable[View]],
    surface: Heights,
    m_per_px: float,
    *,
    folder: Path | None = None,
    on_view: Callable[[], None] = lambda: None,
) -> Orthomosaic:
    """Return the mosaic of views, whose brightness is equalised over all of them together.

    Args:
        views: yields the same (key) views in the same order each time; only one is in memory.
        surface: heights in the map frame.
        m_per_px: side of a pixel [m].
        folder: for tiles that are not in use; None keeps all in memory.
        on_view: called once for each view and pass.

    Raises:
        UavVslamError: some views are grey and others in colour.
    """
    exposure = Exposure()
    useless: set[int] = set()
    sharpness: dict[int, float] = {}
    for number, view in enumerate(views()):
        thumb = thumbnail(view, surface, m_per_px)
        if thumb is None:
            useless.add(number)
        else:
            exposure.add(thumb, view.vehicle)
            sharpness[number] = sharpness_of(view.image)
        on_view()
    exposure.solve()
    usual = float(np.median(list(sharpness.values()))) if sharpness else 1.0
    mosaic = Orthomosaic(surface, m_per_px, folder=folder, exposure=exposure)
    for number, view in enumerate(views()):
        if number not in useless:
            mosaic.add(view, sharpness=_counting(sharpness[number], usual))
        on_view()
    return mosaic


def _counting(sharpness: float, usual: float) -> float:
    """Return the factor of a view's score: one unless it is blurred, as sharpness varies with the ground, too."""
    return 1.0 if sharpness >= LEAST_SHARPNESS * usual else sharpness / usual
