# SPDX-License-Identifier: Apache-2.0
"""What a node graph recorded of its flight, as a result to be scored."""

from typing import Any

from uav_vslam.datasets.outputs import RecordedOutputs
from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory


def flight_result(
    name: str, outputs: dict[str, RecordedOutputs], *, config: dict[str, Any], wall_s: float
) -> FlightResult:
    """Return recorded outputs as a flight."""
    vehicles = {vehicle: _vehicle_result(vehicle, recorded, outputs) for vehicle, recorded in outputs.items()}
    stamps = [estimate.stamp_ns for recorded in outputs.values() for estimate in recorded.own_only]
    modes = {recorded.link.mode for recorded in outputs.values() if recorded.link is not None}
    return FlightResult(
        name=name,
        seed=None,
        mode=modes.pop() if len(modes) == 1 else "mixed" if modes else "none",
        duration_s=(max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0,
        wall_s=wall_s,
        vehicles=vehicles,
        config=config,
    )


def _vehicle_result(name: str, recorded: RecordedOutputs, fleet: dict[str, RecordedOutputs]) -> VehicleResult:
    s_slam = Trajectory.from_estimates(recorded.own_only)
    frames = sorted(recorded.frames, key=lambda frame: frame.stamp_ns)
    return VehicleResult(
        name=name,
        truth=Trajectory.from_estimates(recorded.truth) if recorded.truth else None,
        ins=Trajectory.from_estimates(recorded.dead_reckoning),
        s_slam=s_slam,
        c_slam=Trajectory.from_estimates(recorded.fused) if _has_peer(recorded, fleet) else None,
        frames_in=recorded.frames_in,
        frames_processed=len(s_slam),
        closures=sum(frame.closures for frame in frames) if frames else None,
        frames=tuple(frames) or None,
        link=recorded.link.counters if recorded.link else LinkCounters(),
        epochs=tuple(sorted(recorded.epochs, key=lambda epoch: epoch.stamp_ns)),
    )


def _has_peer(recorded: RecordedOutputs, fleet: dict[str, RecordedOutputs]) -> bool:
    """Tell whether the fused track means anything: without a peer it repeats the own-only one.

    The mode is the last one: who was switched to `none` in flight had fused before.
    """
    link = recorded.link
    if not recorded.fused or link is None or (link.mode == "none" and not link.counters.packets_used):
        return False
    return bool(link.peers) or len(fleet) > 1
