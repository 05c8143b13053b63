# SPDX-License-Identifier: Apache-2.0
"""A flight's data for evaluation, from the offline graph, the node graph or bags."""

from dataclasses import dataclass, field
from typing import Any

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.types import FrameQuality, LinkEpoch, MappedLandmarks


@dataclass(frozen=True, slots=True)
class LinkCounters:
    """Statistics of one vehicle's radio link.

    Attributes:
        sent_bytes_per_s: payload sent, averaged over the flight [B/s].
        packets_sent: by this vehicle.
        packets_received, packets_used: from all peers.
        dropped: packets dropped, by reason.
        packets_waiting: received, and neither used nor dropped at the end.
    """

    sent_bytes_per_s: float = 0.0
    packets_sent: int = 0
    packets_received: int = 0
    packets_used: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    packets_waiting: int = 0


@dataclass(frozen=True, slots=True)
class VehicleResult:
    """One vehicle's flight.

    Attributes:
        name: the vehicle's namespace.
        truth: true poses, or None if unknown.
        ins: dead reckoning from the start state, never corrected.
        s_slam: own-only SLAM; all tracks are scored at its stamps.
        c_slam: fused with peers; None for a vehicle without peers.
        smoothed: own-only poses given the whole flight, made afterwards; None if it was not smoothed.
        frames_in: stereo pairs offered, or None if not counted.
        frames_processed: stereo pairs that became an estimate.
        closures: landmarks recognised after a long absence, or None if not counted.
        frames: how each frame processed went, in stamp order; None if not recorded.
        alarms: camera and rig faults by the stamp [ns] of their frame; None if not recorded.
        dropped: frames that were not processed, by reason.
        landmarks: each as last estimated at an epoch; None if not recorded.
        link: radio counters.
        epochs: traffic up to each fusion epoch, in stamp order; empty if not recorded.
        stage_s: processor time of a stage on each frame [s], by the stage's name and the stamp [ns]; empty if not
            recorded.
    """

    name: str
    truth: Trajectory | None
    ins: Trajectory
    s_slam: Trajectory
    c_slam: Trajectory | None
    frames_in: int | None
    frames_processed: int
    smoothed: Trajectory | None = None
    closures: int | None = None
    frames: tuple[FrameQuality, ...] | None = None
    alarms: dict[int, tuple[str, ...]] | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    landmarks: MappedLandmarks | None = None
    link: LinkCounters = field(default_factory=LinkCounters)
    epochs: tuple[LinkEpoch, ...] = ()
    stage_s: dict[str, dict[int, float]] = field(default_factory=dict)

    @property
    def start_ns(self) -> int:
        """Stamp of the first frame, from which tables count time [ns]; 0 without any."""
        first = self.frames[0].stamp_ns if self.frames else next(iter(self.s_slam.stamps_ns), 0)
        return int(first)


@dataclass(frozen=True, slots=True)
class FlightResult:
    """A flight of a fleet.

    Attributes:
        name: of the scenario or bag; it names the results folder.
        seed: of the simulation, or None.
        mode: communication mode.
        duration_s: flight time [s].
        wall_s: processing time [s].
        vehicles: by name.
        config: the resolved configuration, as a ROS parameter file has it.
        bags: absolute paths of the recordings; empty for a simulated flight.
    """

    name: str
    seed: int | None
    mode: str
    duration_s: float
    wall_s: float
    vehicles: dict[str, VehicleResult]
    config: dict[str, Any] = field(default_factory=dict)
    bags: tuple[str, ...] = ()
