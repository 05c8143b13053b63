# SPDX-License-Identifier: Apache-2.0
"""A fleet: own-only tracks, then packets and fusion.

Own-only tracks are independent, so each vehicle has a worker process if cores allow. The result is the same, bit for
bit, for any number of workers.
"""

from collections.abc import Callable
from functools import partial

from uav_vslam.config import VehicleConfig
from uav_vslam.fleet import CooperativeTrack, PacketLink, cooperate
from uav_vslam.offline.source import FlightSource
from uav_vslam.offline.track import track_vehicle
from uav_vslam.offline.workers import track_in_workers
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
        Own-only and cooperative tracks by vehicle.
    """
    track = partial(track_vehicle, keep_features=keep_features, smoothing=smoothing, keep_map=keep_maps)
    if workers == 1 or len(sources) == 1:
        tracks = [track(source, configs[source.vehicle], lambda: on_frame(1)) for source in sources]
    else:
        tracks = track_in_workers(track, sources, configs, workers, on_frame)
    by_name = {track.vehicle: track for track in tracks}
    return by_name, cooperate(by_name, configs, links)
