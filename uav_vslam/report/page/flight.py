# SPDX-License-Identifier: Apache-2.0
"""Reads the results folder of a flight for the page."""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.results_folder import Tracks, read_results
from uav_vslam.evaluation.files.tables import Columns, read_columns
from uav_vslam.evaluation.output import CONFIG, SUMMARY
from uav_vslam.types import NS_PER_S
from uav_vslam.yaml_text import parse_yaml

Figures = dict[str, Any]

TABLES = ("frames", "link", "timing", "landmarks")


class _Tree(dict[str, Any]):
    """A tree of a file."""

    def __init__(self, path: Path, content: Figures) -> None:
        super().__init__(content)
        self._path = path

    def __missing__(self, name: str) -> Any:
        raise UavVslamError(f"{self._path} lacks {name!r}: it is damaged, or of another version; run again")


@dataclass(frozen=True, slots=True)
class VehicleFiles:
    """What a results folder holds of one vehicle.

    Attributes:
        name: of the vehicle.
        tracks: trajectories by name (`output.ALL_TRACKS`).
        tables: cells of the columns of `<vehicle>_<table>.csv`, by `TABLES`; those that are there.
    """

    name: str
    tracks: Tracks
    tables: dict[str, Columns]


@dataclass(frozen=True, slots=True)
class FlightFiles:
    """What a results folder holds.

    Attributes:
        label: distinguishes it from the other flights of the page.
        folder: of the results.
        summary: content of summary.json.
        config: content of config.yaml.
        vehicles: by name.
        start_ns: first stamp of an own-only track, from which the page counts time.
    """

    label: str
    folder: Path
    summary: Figures
    config: Figures
    vehicles: dict[str, VehicleFiles]
    start_ns: int

    def seconds_of(self, stamps_ns: Any) -> Any:
        """Return stamps [ns] as seconds since the start."""
        return (stamps_ns - self.start_ns) / NS_PER_S


def read_flight(folder: Path, label: str) -> FlightFiles:
    """Read the results of a flight.

    Raises:
        UavVslamError: the folder holds no flight, or a file is damaged.
    """
    if not (folder / SUMMARY).exists():
        raise UavVslamError(
            f"{folder} holds no {SUMMARY}; name the results of a flight, which `uav-vslam run` makes of a recording, a "
            "study or a mosaic"
        )
    summary = read_json(folder / SUMMARY)
    vehicles_of = summary.get("vehicles")
    if not isinstance(vehicles_of, dict) or not all(isinstance(figures, dict) for figures in vehicles_of.values()):
        raise UavVslamError(f"{folder / SUMMARY} lists no vehicles; name the results of a flight, a study or a mosaic")
    tracks = read_results(folder)
    vehicles = {name: VehicleFiles(name, tracks.get(name, {}), _tables(folder, name)) for name in vehicles_of}
    own_only = [vehicle.tracks["s_slam"] for vehicle in vehicles.values() if "s_slam" in vehicle.tracks]
    start_ns = min((int(track.stamps_ns[0]) for track in own_only), default=0)
    return FlightFiles(label, folder, summary, _config(folder / CONFIG), vehicles, start_ns)


def read_json(path: Path) -> Figures:
    """Read a tree, in which to look up a name that it lacks is an error of the file.

    Raises:
        UavVslamError: the file is missing, is no JSON, or holds no tree.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"), object_hook=partial(_Tree, path))
    except OSError as error:
        raise UavVslamError(
            f"{path} can't be read: {error.strerror}; name the results of a flight, a study or a mosaic"
        ) from None
    except ValueError as error:
        raise UavVslamError(f"{path} is no JSON: {error}; was the run interrupted?") from None
    if not isinstance(tree, dict):
        raise UavVslamError(f"{path} holds no figures by name; name a folder of results")
    return tree


def _config(path: Path) -> Figures:
    try:
        return dict(parse_yaml(path.read_text(encoding="utf-8")) or {}) if path.exists() else {}
    except (ValueError, TypeError) as error:
        raise UavVslamError(f"{path} is no configuration: {error}; restore or remove it") from None


def _tables(folder: Path, vehicle: str) -> dict[str, Columns]:
    paths = {name: folder / f"{vehicle}_{name}.csv" for name in TABLES}
    return {name: read_columns(path) for name, path in paths.items() if path.exists()}
