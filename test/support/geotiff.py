# SPDX-License-Identifier: Apache-2.0
"""Reads a GeoTIFF as a GIS does: by its tags, and PROJ for the projection that these describe."""

from pathlib import Path

import numpy as np
import pyproj
import tifffile


def place(path: Path, row: float, column: float) -> tuple[float, float]:
    """Return longitude and latitude of a pixel's centre, by the file alone."""
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        tags = {tag.code: tag.value for tag in page.tags.values()}
        geo = page.geotiff_tags
        if 34264 in tags:
            matrix = np.reshape(tags[34264], (4, 4))
        else:
            (sx, sy, _), (_, _, _, x, y, _) = tags[33550], tags[33922]
            matrix = np.array([[sx, 0, 0, x], [0, -sy, 0, y], [0, 0, 0, 0], [0, 0, 0, 1.0]])
        assert geo["GTRasterTypeGeoKey"] == 1
        crs = (
            f"+proj=tmerc +ellps=WGS84 +units=m +lat_0={geo['ProjNatOriginLatGeoKey']:.10f} "
            f"+lon_0={geo['ProjNatOriginLongGeoKey']:.10f} +k_0={geo['ProjScaleAtNatOriginGeoKey']:.12f}"
        )
    x, y, *_ = matrix @ [column + 0.5, row + 0.5, 0.0, 1.0]
    return pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)
