# SPDX-License-Identifier: Apache-2.0
"""What evaluation takes of a flight: the tracks of all vehicles as one record."""

from collections.abc import Sequence
from pathlib import Path

from uav_vslam.config import VehicleConfig, parameter_file
from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult
from uav_vslam.evaluation.start_frame import in_start_frame
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import CooperativeTrack
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.types import NS_PER_S


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
        vehicle: _vehicle_result(track, members[vehicle], truths[vehicle], configs[vehicle], alone=len(tracks) == 1)
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
        packets_used=sum(record.used for record in peers),
        packets_waiting=sum(record.waiting for record in peers),
        dropped=dropped,
    )


def _vehicle_result(
    track: VehicleTrack,
    member: CooperativeTrack | None,
    truth: Trajectory | None,
    config: VehicleConfig,
    *,
    alone: bool,
) -> VehicleResult:
    own = track.poses
    s_slam = Trajectory.from_estimates(own)
    sender = None if alone else member  # packets that nobody can receive are no traffic
    if truth is not None and own and config.start.defines_map:
        truth = in_start_frame(truth, s_slam)
    return VehicleResult(
        name=track.vehicle,
        truth=truth,
        ins=Trajectory.from_estimates([output.dead_reckoning.pose for output in track.outputs]),
        s_slam=s_slam,
        c_slam=Trajectory.from_estimates(member.poses) if member else None,
        smoothed=Trajectory.from_estimates(track.smoothed) if track.smoothed else None,
        frames_in=track.frames_in,
        frames_processed=len(track.outputs),
        closures=sum(output.report.closures for output in track.outputs),
        frames=tuple(output.quality for output in track.outputs),
        alarms=track.alarms,
        dropped=track.dropped,
        landmarks=track.landmarks.landmarks(),
        link=link_counters(sender) if sender else LinkCounters(),
        epochs=tuple(sender.epochs) if sender else (),
        stage_s=track.stage_s | ({"fusion": member.fusion_s} if member else {}),
    )
