# SPDX-License-Identifier: Apache-2.0
"""Own-only flights as one sequence of frames, from this process or from workers that fly some frames ahead."""

import itertools
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack

from uav_vslam.config import VehicleConfig
from uav_vslam.fleet import in_stamp_order, named
from uav_vslam.offline.source import FlightSource
from uav_vslam.offline.track import VehicleFlight
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.processes import worker_pool
from uav_vslam.slam.frame_output import FrameOutput

Frame = tuple[str, FrameOutput]  # with the vehicle's name
BATCH = 8  # frames that a worker returns at a time
AHEAD = 32  # batches that a worker may be ahead: 40 s of flight, 100 MB of beliefs over 200 landmarks


class FlightGroup:
    """Vehicles that fly in this process; takes the options of a `VehicleFlight`."""

    def __init__(self, sources: Sequence[FlightSource], configs: dict[str, VehicleConfig], **options: bool) -> None:
        self._flights = [VehicleFlight(source, configs[source.vehicle], **options) for source in sources]

    def frames(self) -> Generator[Frame]:
        """Yield the output of each frame by stamp and vehicle."""
        yield from in_stamp_order(named(flight.track.vehicle, flight) for flight in self._flights)

    @property
    def tracks(self) -> dict[str, VehicleTrack]:
        """By vehicle; complete after the last frame."""
        return {flight.track.vehicle: flight.track for flight in self._flights}


class WorkerFlights:
    """Groups of vehicles, each in a process of its own.

    Attributes:
        tracks: by vehicle; empty before the last frame.
    """

    def __init__(
        self, group: Callable[[Sequence[FlightSource]], FlightGroup], parts: Sequence[Sequence[FlightSource]]
    ) -> None:
        """Prepare; `group` is called with each of the parts in its process."""
        self.tracks: dict[str, VehicleTrack] = {}
        self._group, self._parts = group, parts

    def frames(self) -> Generator[Frame]:
        """Yield the output of each frame by stamp and vehicle.

        Raises:
            WorkerEnded: the system has ended a worker.
        """
        with ExitStack() as stack:
            pools = [stack.enter_context(worker_pool(1)) for _ in self._parts]
            begun = [pool.submit(_begin, self._group, part) for pool, part in zip(pools, self._parts, strict=True)]
            batches = [deque(pool.submit(_next_batch) for _ in range(AHEAD)) for pool in pools]
            for future in begun:
                future.result()
            yield from in_stamp_order(map(_received, pools, batches))
            for pool in pools:
                self.tracks |= pool.submit(_tracks).result()


def _received(pool: ProcessPoolExecutor, batches: deque[Future[list[Frame]]]) -> Iterator[Frame]:
    """Yield the frames of a worker, and let it go on as they are taken."""
    while batch := batches.popleft().result():
        batches.append(pool.submit(_next_batch))
        yield from batch


# In a worker: its only group, and the frames that are left.
_flights: FlightGroup
_frames: Iterator[Frame]


def _begin(group: Callable[[Sequence[FlightSource]], FlightGroup], part: Sequence[FlightSource]) -> None:
    global _flights, _frames
    _flights = group(part)
    _frames = _flights.frames()


def _next_batch() -> list[Frame]:
    return list(itertools.islice(_frames, BATCH))


def _tracks() -> dict[str, VehicleTrack]:
    return _flights.tracks
