# SPDX-License-Identifier: Apache-2.0
"""The engine of the fusion studies: own-only tracks are computed once, then fused under each setting."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import EXACT_RIG, FusionConfig, LinkConfig, VehicleConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.link import Link
from uav_vslam.errors import UavVslamError
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.fleet import PacketLink, cooperate
from uav_vslam.geometry.pose import POSE_DIM
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.search import rows_of
from uav_vslam.simulation.landmarks import LandmarkNoise
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.own_only import prepare
from uav_vslam.studies.engine.scores import errors_and_nees
from uav_vslam.studies.engine.separate_frames import OwnOnlyTracks, fly_own_only, with_mistaken_landmarks
from uav_vslam.studies.engine.write_back import WRITE_BACK, fly_with_write_back
from uav_vslam.types import NS_PER_S, LandmarkPacket

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Setting:
    """One cooperation setting.

    Attributes:
        name: label of its rows.
        fusion: settings of `FusionConfig` that differ from the defaults.
        link: the radio, the same in every direction but for its random draws; default: perfect.
        out_of_range: vehicles that receive nothing from each other.
        restarts: how often the second vehicle restarts from a checkpoint, spread over the flight.
        write_back: name in `write_back.WRITE_BACK`, which replaces the fusion node's method.
    """

    name: str
    fusion: Mapping[str, Any] = field(default_factory=dict)
    link: LinkConfig = field(default_factory=LinkConfig)
    out_of_range: tuple[str, ...] = ()
    restarts: int = 0
    write_back: str = ""

    def channel(self, base: FusionConfig) -> str:
        """Return the content sent over the radio; keys that the setting does not change are those of `base`."""
        if self.write_back:
            return WRITE_BACK[self.write_back].channel
        fusion = dataclasses.replace(base, **self.fusion)
        if fusion.mode == "none":
            return "nothing"
        size = fusion.mode if fusion.mode == "narrowband" else f"up to {fusion.max_packet_landmarks} landmarks"
        more = [name for name, on in (("feedback", fusion.returns_feedback), ("relay", fusion.relay)) if on]
        return ", ".join([f"own maps, {size}", *more])


@dataclass(frozen=True, slots=True)
class Outcome:
    """One vehicle of one seed under one setting.

    Attributes:
        setting, seed, vehicle: which.
        times_s: (F,) of the frames since the first one.
        own_error, error: (F,) distance from the truth, alone and with peers [m].
        own_nees, nees: (F,) of the position.
        sigma: (F,) root of the trace of the fused position's covariance [m].
        correction: (F, 3) fused less own position [m].
        failure: why the estimate failed; empty if it did not.
        figures: of the link, and the fusion's time.
    """

    setting: str
    seed: int
    vehicle: str
    times_s: Array
    own_error: Array
    error: Array
    own_nees: Array
    nees: Array
    sigma: Array
    correction: Array
    failure: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


def run_settings(
    scenario: Scenario,
    settings: tuple[Setting, ...],
    config: VehicleConfig,
    noise: LandmarkNoise,
    *,
    mistaken_share: float,
) -> list[Outcome]:
    """Fly a scenario's vehicles alone, then fuse them under every setting.

    Args:
        scenario, settings, config, noise: flight, what to compare, and what they share.
        mistaken_share: of the landmarks that the first two vehicles have in common and one mistakes for others;
            settings that write back fly on their own, without.
    """
    config = dataclasses.replace(config, imu=scenario.imu_config)
    flown = fly_own_only(scenario, config, noise)
    if mistaken_share:
        flown, _ = with_mistaken_landmarks(flown, mistaken_share, scenario.seed)
    outcomes: list[Outcome] = []
    for setting in settings:
        if setting.write_back:
            outcomes += _written_back(scenario, setting, config, noise, flown)
        else:
            outcomes += _fused(scenario, setting, config, flown)
    return outcomes


def _fused(scenario: Scenario, setting: Setting, config: VehicleConfig, flown: OwnOnlyTracks) -> list[Outcome]:
    tracks = flown.tracks
    fusion = dataclasses.replace(config.fusion, **setting.fusion)
    configs = {name: dataclasses.replace(config, fusion=fusion) for name in tracks}
    monitor = _PacketMonitor()
    started = time.process_time()
    try:
        fleet = cooperate(_restarted(tracks, setting.restarts), configs, _links(scenario, setting), monitor.on_packet)
    except (UavVslamError, np.linalg.LinAlgError) as error:
        return [_failed(scenario, setting, name, str(error)) for name in tracks]
    epochs = sum(output.joint is not None for track in tracks.values() for output in track.outputs)
    fusing_s = time.process_time() - started - monitor.overhead_s
    shared = {"lambda_excess": monitor.largest - 1.0} if monitor.largest else {}  # without packets, nothing is measured
    if epochs:  # none in a flight that ends before the first
        shared["ms_per_epoch"] = 1e3 * fusing_s / epochs
    outcomes = []
    for name, track in tracks.items():
        member = fleet[name]
        figures = {
            **shared,
            "sent_bytes_per_s": member.exchange.outbox.sent_bytes_per_s,
            "packet_bytes_max": monitor.largest_bytes.get(name, 0),
            "recovery_packets": monitor.until_used(member.fusion, setting.link),
        }
        estimate = Trajectory.from_estimates(member.poses)
        outcomes.append(_scored(scenario, setting, name, track, estimate, flown.truths[name], figures))
    return outcomes


def _written_back(
    scenario: Scenario, setting: Setting, config: VehicleConfig, noise: LandmarkNoise, flown: OwnOnlyTracks
) -> list[Outcome]:
    exact = dataclasses.replace(config, rig=EXACT_RIG)  # as the thesis has it: what counts twice would be blamed on it
    found = fly_with_write_back(prepare(scenario, noise), exact, WRITE_BACK[setting.write_back])
    return [
        _failed(scenario, setting, name, track.failure)
        if track.failure
        else _scored(scenario, setting, name, flown.tracks[name], track.estimate, flown.truths[name], {})
        for name, track in found.items()
    ]


def _scored(
    scenario: Scenario,
    setting: Setting,
    name: str,
    alone: VehicleTrack,
    estimate: Trajectory,
    truth: Trajectory,
    figures: Mapping[str, float],
) -> Outcome:
    own = Trajectory.from_estimates(alone.poses)
    own_error, own_nees = errors_and_nees(own, truth)
    error, fused_nees = errors_and_nees(estimate, truth)
    assert estimate.covariance is not None
    sigma = np.sqrt(np.trace(estimate.covariance[:, :3, :3], axis1=1, axis2=2))
    times_s = (estimate.stamps_ns - truth.stamps_ns[0]) / NS_PER_S
    failure = "" if np.isfinite(fused_nees).all() else "covariance not positive definite"
    return Outcome(
        setting.name,
        scenario.seed,
        name,
        times_s,
        own_error,
        error,
        own_nees,
        fused_nees,
        sigma,
        estimate.positions - own.positions[: len(estimate)],
        failure,
        figures,
    )


def _failed(scenario: Scenario, setting: Setting, name: str, failure: str) -> Outcome:
    none, no_correction = np.zeros(0), np.zeros((0, 3))
    return Outcome(setting.name, scenario.seed, name, none, none, none, none, none, none, no_correction, failure)


def _links(scenario: Scenario, setting: Setting) -> Callable[[str, str], PacketLink]:
    """Return a factory of links whose random draws differ by seed and direction."""
    names = [scenario.vehicle_name(k) for k in range(scenario.vehicles)]

    def link(sender: str, receiver: str) -> PacketLink:
        unreachable = sender in setting.out_of_range and receiver in setting.out_of_range
        seed = 1000 * scenario.seed + names.index(sender) * len(names) + names.index(receiver)
        return Link(dataclasses.replace(setting.link, seed=seed, loss=1.0 if unreachable else setting.link.loss))

    return link


def _restarted(tracks: dict[str, VehicleTrack], restarts: int) -> dict[str, VehicleTrack]:
    """Return the tracks with the second vehicle's sessions counting up, as if it went on from checkpoints."""
    if restarts == 0:
        return tracks
    name = sorted(tracks)[1]
    outputs = tracks[name].outputs
    length = len(outputs) // (restarts + 1) + 1
    changed = list(outputs)
    for k, output in enumerate(outputs):
        if output.joint is not None:
            joint = dataclasses.replace(output.joint, session=output.joint.session + k // length)
            changed[k] = dataclasses.replace(output, joint=joint)
    return {**tracks, name: dataclasses.replace(tracks[name], outputs=changed)}


class _PacketMonitor:
    """Compares every packet's covariance with that of the sender's belief.

    Attributes:
        largest: the largest eigenvalue of R^-1 P over all packets; above 1 a packet is over-confident.
        largest_bytes: of the packets of each vehicle.
        overhead_s: CPU time of the monitor itself [s].
    """

    def __init__(self) -> None:
        self.largest = 0.0
        self.overhead_s = 0.0
        self.largest_bytes: dict[str, int] = {}
        self._sent_ns: dict[str, dict[tuple[int, int], int]] = {}

    def until_used(self, fusion: Fusion, link: LinkConfig) -> float:
        """Return how many packets each peer had to send after the last blackout until one was used, at worst."""
        if not link.blackouts:
            return 0.0
        counts = [1]
        for peer, record in fusion.inbox.peers.items():
            sent = self._sent_ns[peer]
            end_ns = min(sent.values()) + round(link.blackouts[-1] * NS_PER_S)
            assert record.used == len(record.recently_used), "a flight of more packets than an inbox remembers"
            after = sorted(key for key, stamp_ns in sent.items() if stamp_ns >= end_ns)
            counts.append(next((k for k, key in enumerate(after, start=1) if key in record.recently_used), len(after)))
        return float(max(counts))

    def on_packet(self, fusion: Fusion, packet: LandmarkPacket, size_bytes: int) -> None:
        """Record a packet that is sent."""
        self._sent_ns.setdefault(packet.vehicle, {})[packet.session, packet.sequence] = packet.stamp_ns
        self.largest_bytes[packet.vehicle] = max(self.largest_bytes.get(packet.vehicle, 0), size_bytes)
        if fusion.belief is None or len(packet) == 0:
            return
        started = time.process_time()
        at = landmark_rows(POSE_DIM, rows_of(packet.ids, fusion.belief.ids))
        P = fusion.belief.covariance[np.ix_(at, at)]
        L = np.linalg.cholesky(packet.covariance)
        half = np.linalg.solve(L, P)
        self.largest = max(self.largest, float(np.linalg.eigvalsh(np.linalg.solve(L, half.T))[-1]))
        self.overhead_s += time.process_time() - started
