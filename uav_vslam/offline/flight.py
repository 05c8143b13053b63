# SPDX-License-Identifier: Apache-2.0
"""A fleet: the own-only tracks of its vehicles, fused as they grow.

Own-only tracks are independent, so each vehicle has a worker process if cores allow. The result is the same, bit for
bit, for any number of workers. The beliefs that are fused take megabytes each; none outlives its epoch.
"""

from collections.abc import Callable
from contextlib import closing
from functools import partial

from uav_vslam.config import VehicleConfig
from uav_vslam.fleet import CooperativeTrack, Fleet, PacketLink
from uav_vslam.offline.source import FlightSource
from uav_vslam.offline.workers import FlightGroup, WorkerFlights
from uav_vslam.pipeline import VehicleTrack


def fly(
    sources: list[FlightSource],
    configs: dict[str, VehicleConfig],
    *,
    workers: int = 1,
    on_frame: Callable[[int], None] = lambda _: None,
    links: Callable[[str, str], PacketLink] | None = None,
    keep_features: bool = False,
    smoothing: bool = False,
    keep_maps: bool = False,
) -> tuple[dict[str, VehicleTrack], dict[str, CooperativeTrack]]:
    """Run a fleet.

    Args:
        sources: one per vehicle.
        configs: by vehicle.
        workers: processes; 1 runs everything in this one.
        on_frame: called with the number of frames processed since the last call.
        links: makes the radio link from a sender to a receiver; without it packets arrive at once.
        keep_features: in the tracks, for pictures.
        smoothing: smooth each whole flight afterwards.
        keep_maps: in the tracks.

    Returns:
        Own-only tracks, without joint information, and cooperative ones, by vehicle.
    """
    vehicles = [source.vehicle for source in sources]
    group = partial(
        FlightGroup,
        configs=configs,
        keep_features=keep_features,
        keep_joints=False,
        keep_map=keep_maps,
        smoothing=smoothing,
    )
    parts = [sources[k::workers] for k in range(min(workers, len(sources)))]
    flights = group(sources) if len(parts) == 1 else WorkerFlights(group, parts)
    fleet = Fleet(vehicles, configs, links, goes_on=True)
    with closing(flights.frames()) as frames:
        for vehicle, output in frames:
            fleet.add(vehicle, output)
            on_frame(1)
    fleet.land()
    for vehicle, member in fleet.members.items():
        flights.tracks[vehicle].warnings += member.warnings
    return {vehicle: flights.tracks[vehicle] for vehicle in vehicles}, fleet.members
