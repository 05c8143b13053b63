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
from uav_vslam.mapping.summary import MapFrame

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
    apart = len(configs) > 1 and not all(config.fusion.common_origin for config in configs.values())
    if apart or sum(config.start.defines_map for config in configs.values()) > 1:
        why = "fusion.common_origin: false" if apart else "start.method: static or in_flight"
        raise UavVslamError(f"the vehicles have map frames of their own ({why}); map one of them: --vehicles NAME")


def mapped_flights(
    folder: Path, bags: Sequence[Path] | None, vehicles: Sequence[str] | None
) -> tuple[list[MappedFlight], MapFrame]:
    """Return the flights of a results folder, and the frame of their poses.

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
    found = [MappedFlight(flights[name], _poses(name, tracks[name])) for name in names]
    return found, _frame(configs, fused=any(_is_fused(tracks[name]) for name in names))


def _frame(configs: Mapping[str, VehicleConfig], *, fused: bool) -> MapFrame:
    """Return the frame of vehicles' poses: that which they share, or the one vehicle's own unless it was fused."""
    name, config = next(iter(configs.items()))
    frames, common = config.frames, config.fusion.common_origin
    of_own = len(configs) == 1 and not fused
    return MapFrame(
        frames.map_of(name) if of_own else frames.world_of(name, common=common),
        north_up=not any(config.start.defines_map for config in configs.values()),
    )


def _recorded(folder: Path) -> list[Path]:
    bags = json.loads((folder / SUMMARY).read_text(encoding="utf-8")).get("bags")
    if not bags:
        raise UavVslamError(f"{folder / SUMMARY} names no recordings; give them with --bags")
    return [Path(bag) for bag in bags]


def _poses(vehicle: str, tracks: dict[str, Trajectory]) -> dict[int, Pose]:
    """Return the best poses for mapping: smoothed ones, where there are peers at the place of the fused ones."""
    smoothed = tracks.get("smoothed")
    if smoothed is None:
        warn(f"{vehicle} has no smoothed poses; its own-only ones blur the map")
        return {pose.stamp_ns: pose.T_map_body for pose in tracks["s_slam"].estimates()}
    poses = smoothed.estimates()
    if _is_fused(tracks):
        poses = anchored(poses, tracks["c_slam"].estimates())
    return {pose.stamp_ns: pose.T_map_body for pose in poses}


def _is_fused(tracks: dict[str, Trajectory]) -> bool:
    """Return whether smoothed poses are moved to the place of fused ones."""
    return "smoothed" in tracks and "c_slam" in tracks and tracks["c_slam"].covariance is not None
