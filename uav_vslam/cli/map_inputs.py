# SPDX-License-Identifier: Apache-2.0
"""What mapping starts from: a results folder's poses, and the recordings it was made of."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.cli.messages import warn
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.results_folder import read_results
from uav_vslam.evaluation.output import CONFIG, SUMMARY
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.anchoring import anchored
from uav_vslam.mapping.flight_views import flight_views

if TYPE_CHECKING:
    from uav_vslam.config import VehicleConfig
    from uav_vslam.evaluation.trajectory import Trajectory
    from uav_vslam.mapping.view import View


@dataclass(frozen=True, slots=True)
class MappedFlight:
    """One vehicle's recording with the poses of its frames.

    Attributes:
        flight: the recording.
        poses: T_map_body by stamp [ns].
    """

    flight: BagFlight
    poses: dict[int, Pose]

    def __len__(self) -> int:
        return len(self.poses)

    def views(self) -> Iterator[View]:
        """Yield the views; each time the images are read again."""
        images = self.flight.left_images(self.poses.keys())
        return flight_views(self.flight.vehicle, self.flight.rig, self.poses, images)


def is_result(path: Path) -> bool:
    """Return whether a path is a results folder."""
    return (path / SUMMARY).is_file()


def require_one_frame(configs: Mapping[str, VehicleConfig]) -> None:
    """Refuse vehicles, by name, that do not share a map frame."""
    if len(configs) > 1 and not all(config.fusion.common_origin for config in configs.values()):
        raise UavVslamError(
            "the vehicles have map frames of their own (fusion.common_origin: false); map one of them: --vehicles NAME"
        )


def mapped_flights(folder: Path, bags: Sequence[Path] | None, vehicles: Sequence[str] | None) -> list[MappedFlight]:
    """Return the flights of a results folder.

    Args:
        folder: of a run.
        bags: the recordings; None for those that the summary names.
        vehicles: only these; None for all.

    Raises:
        UavVslamError: the folder names no recordings, a vehicle is not there, or vehicles don't share a map frame.
    """
    from uav_vslam.cli.recordings import open_flights
    from uav_vslam.config import load_resolved

    tracks, configs = read_results(folder), load_resolved(folder / CONFIG)
    names = list(vehicles or tracks)
    if missing := sorted(set(names) - set(tracks)):
        raise UavVslamError(f"{folder} has no flight of {', '.join(missing)}; it has {', '.join(tracks)}")
    configs = {name: configs[name] for name in names}
    require_one_frame(configs)
    flights = open_flights(bags or _recorded(folder), configs)
    return [MappedFlight(flights[name], _poses(name, tracks[name])) for name in names]


def _recorded(folder: Path) -> list[Path]:
    bags = json.loads((folder / SUMMARY).read_text(encoding="utf-8")).get("bags")
    if not bags:
        raise UavVslamError(f"{folder / SUMMARY} names no recordings; give them with --bags")
    return [Path(bag) for bag in bags]


def _poses(vehicle: str, tracks: dict[str, Trajectory]) -> dict[int, Pose]:
    """Return the best poses for mapping: smoothed ones, where there are peers at the place of the fused ones."""
    smoothed, fused = tracks.get("smoothed"), tracks.get("c_slam")
    if smoothed is None:
        warn(f"{vehicle} has no smoothed poses; its own-only ones blur the map")
        return {pose.stamp_ns: pose.T_map_body for pose in tracks["s_slam"].estimates()}
    poses = smoothed.estimates()
    if fused is not None and fused.covariance is not None:
        poses = anchored(poses, fused.estimates())
    return {pose.stamp_ns: pose.T_map_body for pose in poses}
