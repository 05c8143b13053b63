# SPDX-License-Identifier: Apache-2.0
"""The mosaic of a finished flight: all gains first, then the picture."""

from collections.abc import Callable, Iterable
from pathlib import Path

from uav_vslam.mapping.orthomosaic.exposure import Exposure
from uav_vslam.mapping.orthomosaic.heights import Heights
from uav_vslam.mapping.orthomosaic.mosaic import Orthomosaic
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
    useless = set()
    for number, view in enumerate(views()):
        thumb = thumbnail(view, surface, m_per_px)
        if thumb is None:
            useless.add(number)
        else:
            exposure.add(thumb, view.vehicle)
        on_view()
    exposure.solve()
    mosaic = Orthomosaic(surface, m_per_px, folder=folder, exposure=exposure)
    for number, view in enumerate(views()):
        if number not in useless:
            mosaic.add(view)
        on_view()
    return mosaic
