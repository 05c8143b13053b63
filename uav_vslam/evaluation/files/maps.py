# SPDX-License-Identifier: Apache-2.0
"""Writes trajectories as GeoJSON (RFC 7946) and KML (OGC 2.3), one line a track.

Lines are cut where they cross the antimeridian (RFC 7946, 3.1.9), between whose sides they would otherwise lead around
the globe in any program that draws coordinates as they are.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum, to_geodetic
from uav_vslam.evaluation.files.whole import whole
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.types import NS_PER_S

Array = NDArray[np.float64]

DEGREE_DECIMALS, METRE_DECIMALS = 9, 3  # 0.1 mm and 1 mm
HALF_TURN_DEG = 180.0
KML = "http://www.opengis.net/kml/2.2"
KML_COLOURS = ("ffd4b800", "ff2827d6", "ff00a5ff", "ff74c476", "ffbc80bd", "ff4dffff")  # aabbggrr


def write_geojson(tracks: Mapping[str, Trajectory], path: Path, datum: Datum) -> Path:
    """Write a line per track, with its name and first and last stamp [s]; altitudes are those of the datum."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "start_s": _seconds(track, 0), "end_s": _seconds(track, -1)},
            "geometry": _geometry(to_geodetic(track.positions, datum)),
        }
        for name, track in tracks.items()
    ]
    with whole(path) as partial:
        partial.write_text(json.dumps({"type": "FeatureCollection", "features": features}) + "\n", encoding="utf-8")
    return path


def _geometry(corners: Array) -> dict[str, Any]:
    """Return (N, 3) longitude, latitude [deg] and altitude [m] as a line, of several parts if it is cut."""
    parts = [_rounded(part) for part in _cut(corners)]
    if len(parts) > 1:
        return {"type": "MultiLineString", "coordinates": parts}
    if len(corners) == 1:  # a line has two ends
        return {"type": "Point", "coordinates": parts[0][0]}
    return {"type": "LineString", "coordinates": parts[0]}


def _cut(corners: Array) -> list[Array]:
    """Return (N, 3) corners in parts that end and begin on the antimeridian where the line crosses it."""
    crossings = np.flatnonzero(np.abs(np.diff(corners[:, 0])) > HALF_TURN_DEG)
    parts = np.split(corners, crossings + 1)
    for k, row in enumerate(crossings):
        side = np.copysign(HALF_TURN_DEG, corners[row, 0])
        before, after = corners[row], corners[row + 1] + [2.0 * side, 0.0, 0.0]  # longitudes continue across
        crossed = before + (side - before[0]) / (after[0] - before[0]) * (after - before)
        parts[k] = np.vstack([parts[k], crossed])
        parts[k + 1] = np.vstack([[-side, *crossed[1:]], parts[k + 1]])
    return parts


def write_kml(tracks: Mapping[str, Trajectory], path: Path, datum: Datum) -> Path:
    """Write a coloured line per track at absolute altitude, which Google Earth counts from sea level."""
    ElementTree.register_namespace("", KML)
    root = ElementTree.Element(_tag("kml"))
    document = _add(root, "Document")
    _add(document, "name", path.stem)
    for k, (name, track) in enumerate(tracks.items()):
        place = _add(document, "Placemark")
        _add(place, "name", name)
        line_style = _add(_add(place, "Style"), "LineStyle")
        _add(line_style, "color", KML_COLOURS[k % len(KML_COLOURS)])
        _add(line_style, "width", "3")
        parts = _cut(to_geodetic(track.positions, datum))
        parent = _add(place, "MultiGeometry") if len(parts) > 1 else place
        for part in parts:
            line = _add(parent, "Point" if len(track) == 1 else "LineString")  # a line has two ends
            _add(line, "altitudeMode", "absolute")
            _add(line, "coordinates", " ".join(",".join(map(str, corner)) for corner in _rounded(part)))
    with whole(path) as partial:
        ElementTree.ElementTree(root).write(partial, encoding="utf-8", xml_declaration=True)
    return path


def _add(parent: ElementTree.Element, name: str, text: str | None = None) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, _tag(name))
    element.text = text
    return element


def _tag(name: str) -> str:
    return f"{{{KML}}}{name}"


def _rounded(coordinates: Array) -> list[list[float]]:
    rounded = np.column_stack([coordinates[:, :2].round(DEGREE_DECIMALS), coordinates[:, 2].round(METRE_DECIMALS)])
    return [[float(value) for value in row] for row in rounded]


def _seconds(track: Trajectory, row: int) -> float:
    return round(int(track.stamps_ns[row]) / NS_PER_S, 3)
