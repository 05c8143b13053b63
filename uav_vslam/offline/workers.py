# SPDX-License-Identifier: Apache-2.0
"""A process for each vehicle as far as cores allow, and the progress of all."""

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from uav_vslam.config import VehicleConfig
from uav_vslam.offline.source import FlightSource
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.processes import worker_pool

POLL_S = 0.2

_progress: Any = None  # a worker's queue to report finished frames


def track_in_workers(
    track: Callable[..., VehicleTrack],
    sources: list[FlightSource],
    configs: dict[str, VehicleConfig],
    workers: int,
    on_frame: Callable[[int], None],
) -> list[VehicleTrack]:
    """Return the sources' tracks, in their order; `track` takes a source, its configuration and a call for each frame.

    Args:
        track: picklable.
        sources: one per vehicle.
        configs: by vehicle.
        workers: processes at most.
        on_frame: called with the number of frames processed since the last call.
    """
    queue = multiprocessing.get_context("spawn").Queue()
    with worker_pool(min(workers, len(sources)), _init_worker, queue) as pool:
        futures: list[Future[VehicleTrack]] = [
            pool.submit(_track_for_pool, track, s, configs[s.vehicle]) for s in sources
        ]
        while not all(future.done() for future in futures):
            time.sleep(POLL_S)
            on_frame(_drain(queue))
        return [future.result() for future in futures]


def _init_worker(queue: Any) -> None:
    global _progress
    _progress = queue


def _track_for_pool(track: Callable[..., VehicleTrack], source: FlightSource, config: VehicleConfig) -> VehicleTrack:
    return track(source, config, lambda: _progress.put(1))


def _drain(queue: Any) -> int:
    count = 0
    while not queue.empty():
        count += queue.get()
    return count
