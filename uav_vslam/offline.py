# SPDX-License-Identifier: Apache-2.0
"""The whole graph offline: each source through its vehicle's pipeline, then packets and fusion, at full speed.

Own-only tracks are independent, so each vehicle has a worker process if cores allow. The result is the same, bit for
bit, for any number of workers.
"""

import multiprocessing
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from uav_vslam.config import VehicleConfig, parameter_file
from uav_vslam.errors import BagError, FilterDivergence, UavVslamError
from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult
from uav_vslam.evaluation.start_frame import in_start_frame
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import CooperativeTrack, PacketLink, cooperate
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.alignment import static_alignment
from uav_vslam.pipeline import VehiclePipeline, VehicleTrack
from uav_vslam.processes import worker_pool
from uav_vslam.slam.health import COASTING_REMEDY, MIN_FEATURES
from uav_vslam.smoothing.flight import FilteredFlight
from uav_vslam.smoothing.smoother import smooth
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, StereoFeatures, StereoFrame

COASTING_SHARE = 0.5  # of the frames, from which the whole flight is in doubt
POLL_S = 0.2


class FlightSource(Protocol):
    """One vehicle's sensor data, recorded or simulated; it must be picklable, for a worker process."""

    @property
    def vehicle(self) -> str:
        """Name."""

    @property
    def rig(self) -> StereoRig:
        """Calibration."""

    @property
    def initial_state(self) -> NavEstimate | None:
        """Start state, or None."""

    @property
    def frame_count(self) -> int:
        """Number of left images, paired or not."""

    def unpaired_reason(self) -> str:
        """Return why images found no partner."""

    def iter_events(self) -> Iterable[ImuSample | StereoFrame | StereoFeatures]:
        """Yield sensor data in stamp order."""


def track_vehicle(
    source: FlightSource,
    config: VehicleConfig,
    on_frame: Callable[[], None] = lambda: None,
    *,
    keep_features: bool = False,
    smoothing: bool = False,
    keep_map: bool = False,
) -> VehicleTrack:
    """Run one vehicle's own-only pipeline over its data; a damaged recording is used up to the damage.

    Args:
        source: sensor data.
        config: of the vehicle.
        on_frame: called after each frame.
        keep_features: in the track, for pictures.
        smoothing: smooth the whole flight afterwards, and the map.
        keep_map: in the track.

    Raises:
        UavVslamError: the source has no start state and the configuration does not set how to find one, or none was
            found; no frame was processed, or no IMU reading used.
    """
    cv2.setNumThreads(1)
    pipeline = VehiclePipeline(
        _start(source, config),
        rig=source.rig,
        config=config,
        vehicle=source.vehicle,
        keep_features=keep_features or smoothing,
        keep_map=keep_map,
    )
    try:
        for _ in pipeline.run(source.iter_events()):
            on_frame()
    except BagError as error:
        pipeline.track.broken = str(error)
    if pipeline.missing_start:
        raise UavVslamError(
            f"{source.vehicle}: none of {pipeline.track.frames_in} frames allowed a start in flight; "
            f"the last: {pipeline.missing_start}"
        )
    _count_unpaired(source, pipeline.track)
    _check_measured(pipeline.track)
    _report_coasting(pipeline.track)
    if keep_map:
        keep_saved_map(pipeline)
    if smoothing:
        smooth_track(pipeline.track, source.rig, config)
    if not keep_features:
        pipeline.track.features.clear()
    return pipeline.track


def _report_coasting(track: VehicleTrack) -> None:
    """Warn of a flight that is mostly dead reckoning although its frames have features."""
    reports = [output.report for output in track.outputs]
    missed = sum(report.coasted and report.features >= MIN_FEATURES for report in reports)
    if missed > COASTING_SHARE * len(reports):
        track.warnings.append(
            f"{missed} of {len(reports)} frames had features, but none where the estimate expects it: what it claims "
            f"is in doubt; {COASTING_REMEDY} (uav-vslam check)"
        )


def keep_saved_map(pipeline: VehiclePipeline) -> None:
    """Add the map to a pipeline's track; without one, why there is none."""
    try:
        pipeline.track.saved_map = pipeline.saved_map()
    except (FilterDivergence, np.linalg.LinAlgError) as error:
        pipeline.track.warnings.append(f"the map could not be saved: {error}")


def smooth_track(track: VehicleTrack, rig: StereoRig, config: VehicleConfig) -> None:
    """Smooth the poses, and the map if there is one, of a track that keeps its features, or add why it failed."""
    if track.start is None or not track.outputs:
        return
    try:
        flight = FilteredFlight.of_outputs(track.start, track.outputs, track.features)
        found = smooth(flight, rig, config, track.saved_map)
        track.smoothed, track.saved_map = [estimate.pose for estimate in found.estimates], found.saved_map
    except (FilterDivergence, np.linalg.LinAlgError, MemoryError) as error:
        track.warnings.append(f"the flight could not be smoothed: {error}")


def _count_unpaired(source: FlightSource, track: VehicleTrack) -> None:
    """Count frames by the images recorded, not by the pairs found.

    Raises:
        UavVslamError: no frame was processed.
    """
    alone = source.frame_count - track.frames_in
    if alone > 0:
        track.dropped["unread" if track.broken else "unpaired"] = alone
        track.frames_in = source.frame_count
    if track.outputs or track.broken or source.frame_count == 0:
        return
    reasons = ", ".join(f"{reason} {count}" for reason, count in track.dropped.items()) or "the IMU does not cover any"
    detail = f"; {source.unpaired_reason()}" if alone > 0 else ""
    raise UavVslamError(f"{source.vehicle}: none of {source.frame_count} frames was processed: {reasons}{detail}")


def _check_measured(track: VehicleTrack) -> None:
    """Check that the flight is more than a guess.

    Raises:
        UavVslamError: no IMU reading was used.
    """
    increments = [output.increment for output in track.outputs if output.increment is not None]
    if increments and not any(increment.samples for increment in increments):
        reasons = ", ".join(f"{reason} {count}" for reason, count in track.dropped.items()) or "none is in the flight"
        raise UavVslamError(
            f"{track.vehicle}: no IMU reading was used ({reasons}), so all motion is unknown; uav-vslam check says "
            "what is wrong with the recording"
        )


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
        tracks = _track_in_workers(track, sources, configs, workers, on_frame)
    by_name = {track.vehicle: track for track in tracks}
    return by_name, cooperate(by_name, configs, links)


def flight_result(
    name: str,
    tracks: dict[str, VehicleTrack],
    fleet: dict[str, CooperativeTrack],
    truths: dict[str, Trajectory | None],
    configs: dict[str, VehicleConfig],
    *,
    seed: int | None = None,
    wall_s: float = 0.0,
    bags: Sequence[Path] = (),
) -> FlightResult:
    """Collect the data for evaluation.

    Args:
        name: of the flight, for its results.
        tracks, fleet: as `fly` returns them.
        truths: ground truth by vehicle, None without.
        configs: by vehicle.
        seed: of a simulated flight.
        wall_s: time that the run took [s].
        bags: recordings of the flight.
    """
    modes = {vehicle: configs[vehicle].fusion.mode if len(tracks) > 1 else "none" for vehicle in tracks}
    fused = {vehicle for vehicle in tracks if modes[vehicle] != "none" or configs[vehicle].start.map}
    members = {vehicle: fleet[vehicle] if vehicle in fused else None for vehicle in tracks}
    vehicles = {
        vehicle: _vehicle_result(track, members[vehicle], truths[vehicle], configs[vehicle])
        for vehicle, track in tracks.items()
    }
    stamps = [output.report.pose.stamp_ns for track in tracks.values() for output in track.outputs]
    return FlightResult(
        name=name,
        seed=seed,
        mode=next(iter(modes.values())) if len(set(modes.values())) == 1 else "mixed",
        duration_s=(max(stamps) - min(stamps)) / NS_PER_S if stamps else 0.0,
        wall_s=wall_s,
        vehicles=vehicles,
        config=parameter_file({f"/{vehicle}/**": config for vehicle, config in configs.items()}),
        bags=tuple(str(path.resolve()) for path in bags),
    )


def link_counters(member: CooperativeTrack) -> LinkCounters:
    """Return the statistics of a vehicle's radio link."""
    peers = member.fusion.inbox.peers.values()
    held_back = member.exchange.dropped["budget"]
    dropped = {"budget": held_back} if held_back else {}
    for record in peers:
        for reason, count in record.dropped.items():
            dropped[reason] = dropped.get(reason, 0) + count
    return LinkCounters(
        sent_bytes_per_s=member.exchange.outbox.sent_bytes_per_s,
        packets_sent=member.exchange.outbox.packets_sent,
        packets_received=sum(record.received for record in peers),
        packets_used=sum(len(record.used) for record in peers),
        packets_waiting=sum(record.waiting for record in peers),
        dropped=dropped,
    )


def _vehicle_result(
    track: VehicleTrack, member: CooperativeTrack | None, truth: Trajectory | None, config: VehicleConfig
) -> VehicleResult:
    own = track.poses
    if truth is not None and own and config.start.defines_map:
        truth = in_start_frame(truth, own[0].stamp_ns)
    return VehicleResult(
        name=track.vehicle,
        truth=truth,
        ins=Trajectory.from_estimates([output.dead_reckoning.pose for output in track.outputs]),
        s_slam=Trajectory.from_estimates(own),
        c_slam=Trajectory.from_estimates(member.poses) if member else None,
        smoothed=Trajectory.from_estimates(track.smoothed) if track.smoothed else None,
        frames_in=track.frames_in,
        frames_processed=len(track.outputs),
        closures=sum(output.report.closures for output in track.outputs),
        frames=tuple(output.quality for output in track.outputs),
        alarms=track.alarms_at,
        dropped=track.dropped,
        joints=tuple(output.joint for output in track.outputs if output.joint is not None),
        link=link_counters(member) if member else LinkCounters(),
        epochs=tuple(member.epochs) if member else (),
        stage_s=track.stage_s | ({"fusion": member.fusion_s} if member else {}),
    )


def _start(source: FlightSource, config: VehicleConfig) -> NavEstimate | None:
    """Return the start state, None if it is to be estimated in flight."""
    if config.start.searches:
        return None
    if config.start.method == "static":
        return _static_start(source, config)
    if source.initial_state is None:
        raise UavVslamError(
            f"{source.vehicle}: the recording has no {source.vehicle}/initial_state; record one, or set "
            "start.method: static for a vehicle that starts at rest, in_flight for one that is already flying, map for "
            "one over ground that it has a map of"
        )
    return source.initial_state


def _static_start(source: FlightSource, config: VehicleConfig) -> NavEstimate:
    samples: list[ImuSample] = []
    for event in source.iter_events():
        if not isinstance(event, ImuSample):
            continue
        samples.append(event)
        if event.stamp_ns - samples[0].stamp_ns >= config.start.rest_s * NS_PER_S:
            break
    return static_alignment(samples, samples[-1].stamp_ns if samples else 0, config.imu)


_progress: Any = None  # a worker's queue to report finished frames


def _init_worker(queue: Any) -> None:
    global _progress
    _progress = queue


def _track_for_pool(track: Callable[..., VehicleTrack], source: FlightSource, config: VehicleConfig) -> VehicleTrack:
    return track(source, config, lambda: _progress.put(1))


def _track_in_workers(
    track: Callable[..., VehicleTrack],
    sources: list[FlightSource],
    configs: dict[str, VehicleConfig],
    workers: int,
    on_frame: Callable[[int], None],
) -> list[VehicleTrack]:
    queue = multiprocessing.get_context("spawn").Queue()
    with worker_pool(min(workers, len(sources)), _init_worker, queue) as pool:
        futures: list[Future[VehicleTrack]] = [
            pool.submit(_track_for_pool, track, s, configs[s.vehicle]) for s in sources
        ]
        while not all(future.done() for future in futures):
            time.sleep(POLL_S)
            on_frame(_drain(queue))
        return [future.result() for future in futures]


def _drain(queue: Any) -> int:
    count = 0
    while not queue.empty():
        count += queue.get()
    return count
