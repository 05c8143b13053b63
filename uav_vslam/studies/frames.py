# SPDX-License-Identifier: Apache-2.0
"""Two vehicles that don't know where each other's map lies: a seed's flights, and what they find out; see `frame_rows`
for the study.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.alignment import Alignment
from uav_vslam.cooperation.common_landmarks import look_alikes
from uav_vslam.cooperation.frame_link import FrameLink
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.cooperation.schemes import Evidence
from uav_vslam.cooperation.unknown_frame import framed
from uav_vslam.estimation.covariance_intersection import Split
from uav_vslam.evaluation.alignment import align_yaw
from uav_vslam.evaluation.consistency import nees, summarise
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.slam.packet import POSE_DIM
from uav_vslam.studies.apart import Flown, draw_offset, fly_own_only, identities, mistaken, moved_apart
from uav_vslam.studies.association_stages import STAGES, UNKNOWN_FRAME, Names, Score, pairs_by_stage, score
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket, PoseEstimate

Array = NDArray[np.float64]

OWN, PEER = "uav1", "uav2"
SHARES = (0.0, 0.3, 0.5)


@dataclass(frozen=True, slots=True)
class Meeting:
    """A packet as it was brought in: rows of pairs are of the own belief and of the packet."""

    joint: JointInformation
    packet: LandmarkPacket
    pairs: NDArray[np.intp]
    alignment: Alignment | None


class RecordingFusion(Fusion):
    """A fusion that remembers what it was told."""

    def __init__(self, vehicle: str, config: FusionConfig) -> None:
        super().__init__(vehicle, config)
        self.meetings: list[Meeting] = []

    def _common(
        self, joint: JointInformation, positions: Array, belief: Split, packet: LandmarkPacket
    ) -> NDArray[np.intp]:
        pairs = super()._common(joint, positions, belief, packet)
        self.meetings.append(Meeting(joint, packet, pairs, None))
        return pairs


class FramingFusion(RecordingFusion):
    """One that knows no peer's frame."""

    def __init__(self, vehicle: str, config: FusionConfig) -> None:
        super().__init__(vehicle, config)
        self._links: dict[str, FrameLink] = {}

    def _common(
        self, joint: JointInformation, positions: Array, belief: Split, packet: LandmarkPacket
    ) -> NDArray[np.intp]:
        link = self._links.setdefault(packet.vehicle, FrameLink())
        covariance = belief.total[POSE_DIM:, POSE_DIM:]
        pairs = link.find_common(positions, covariance, joint.descriptors, packet, config=self._config)
        self.meetings.append(Meeting(joint, packet, pairs, link.alignment))
        return pairs

    def _evidence(
        self, positions: Array, packet: LandmarkPacket, pairs: NDArray[np.intp], *, dependent: bool
    ) -> Evidence:
        alignment = self._links[packet.vehicle].alignment
        assert alignment is not None  # there are pairs
        floor_m = self._config.floor_sigma_m
        return framed(
            positions, packet, pairs, alignment.T_own_peer, floor_sigma_m=floor_m, dependent=dependent
        ).evidence


@dataclass(frozen=True, slots=True)
class FrameRun:
    """One seed with one share of mistaken landmarks.

    Attributes:
        seed, share: which.
        found_s: from the first frame to the first alignment; None if there was none.
        matches: by ratio and mutual test in the packet that gave the first alignment, or in the last one.
        used: those that the first alignment rests on.
        errors: (P, 2) of each alignment [m], [deg], the first one's first.
        nees: of the first alignment.
        ate_m, pose_nees: of each vehicle, by track: alone, unknown (frame), known (frame); see `evaluation`.
        stages: pairs that each stage of association leaves of uav1's.
    """

    seed: int
    share: float
    found_s: float | None
    matches: Score
    used: Score
    errors: Array
    nees: float | None
    ate_m: dict[str, dict[str, float]]
    pose_nees: dict[str, dict[str, float]]
    stages: dict[str, Score]


def run_seed(scenario: Scenario) -> list[FrameRun]:
    """Fly one seed alone, then bring its vehicles together with each share of mistaken landmarks."""
    flown = fly_own_only(scenario)
    return [_run(flown, scenario.seed, share) for share in SHARES]


def meet(flown: Flown, fusions: Mapping[str, Fusion]) -> dict[str, Trajectory]:
    """Exchange packets and fuse, as `fleet.cooperate` does over perfect links; return the fused trajectories."""
    outputs = [(o.report.pose.stamp_ns, name, o) for name, track in flown.tracks.items() for o in track.outputs]
    poses: dict[str, list[PoseEstimate]] = {name: [] for name in fusions}
    for _, name, output in sorted(outputs, key=lambda item: item[:2]):
        if output.joint is not None:
            fusions[name].fuse(output.joint)
            packet = fusions[name].packet(output.joint)
            for other in fusions:
                if other != name:
                    fusions[other].inbox.add(packet)
        poses[name].append(fusions[name].carry(output.report.pose))
    return {name: Trajectory.from_estimates(estimates) for name, estimates in poses.items()}


def map_to_map(own: JointInformation, peer: JointInformation, names: tuple[Names, Names]) -> tuple[Pose, Array]:
    """Return the T_own_peer that fits two maps best, and the (3,) centre of what they share in the peer's frame [m].

    Args:
        own, peer: the maps.
        names: true identities by identifier, of each.
    """
    own_ids, peer_ids = (
        [known[k] for k in joint.ids.tolist()] for joint, known in zip((own, peer), names, strict=True)
    )
    _, a, b = np.intersect1d(own_ids, peer_ids, return_indices=True)
    return align_yaw(peer.positions[b], own.positions[a]), peer.positions[b].mean(axis=0)


def _run(flown: Flown, seed: int, share: float) -> FrameRun:
    T_peer_own = draw_offset(seed)  # the frames, as they truly lie
    names = identities(flown, OWN), identities(flown, PEER)
    shared = set(names[0].values())
    candidates = [k for k, name in names[1].items() if name in shared]
    spoilt, wrong = mistaken(flown, PEER, share, seed, among=candidates)
    apart = moved_apart(spoilt, PEER, T_peer_own)
    config = FusionConfig()
    fusions = {name: FramingFusion(name, config) for name in apart.tracks}
    unknown = meet(apart, fusions)
    in_common_frame = {name: RecordingFusion(name, config) for name in spoilt.tracks}
    known = meet(spoilt, in_common_frame)
    alone = {
        name: Trajectory.from_estimates([o.report.pose for o in track.outputs]) for name, track in apart.tracks.items()
    }
    tracks = {"alone": (alone, apart), "unknown": (unknown, apart), "known": (known, spoilt)}
    maps = {o.joint.stamp_ns: o.joint for track in apart.tracks.values() for o in track.outputs if o.joint is not None}
    meetings = fusions[OWN].meetings
    aligned = [(m, m.alignment) for m in meetings if m.alignment is not None]
    errors = [
        _error(alignment.T_own_peer, *map_to_map(maps[m.joint.stamp_ns], maps[m.packet.stamp_ns], names))
        for m, alignment in aligned
    ]
    found, alignment = aligned[0] if aligned else (meetings[-1], None)
    matches = look_alikes(found.joint.descriptors, found.packet, config.ratio)
    start_ns = apart.tracks[OWN].outputs[0].report.pose.stamp_ns
    return FrameRun(
        seed=seed,
        share=share,
        found_s=(found.joint.stamp_ns - start_ns) / NS_PER_S if alignment else None,
        matches=score(matches, found.joint, found.packet, names, wrong),
        used=score(found.pairs, found.joint, found.packet, names, wrong),
        errors=np.array(errors).reshape(-1, 2),
        nees=_nees(alignment, T_peer_own.inverse()) if alignment else None,
        ate_m=_scores(tracks, _ate),
        pose_nees=_scores(tracks, _pose_nees),
        stages={
            **_stages(in_common_frame[OWN].meetings, config, names, wrong),
            UNKNOWN_FRAME: sum(
                (score(m.pairs, m.joint, m.packet, names, wrong) for m in fusions[OWN].meetings), Score()
            ),
        },
    )


def _stages(
    meetings: Sequence[Meeting], config: FusionConfig, names: tuple[Names, Names], mistaken: set[int]
) -> dict[str, Score]:
    total = dict.fromkeys(STAGES, Score())
    for m in meetings:
        for stage, pairs in pairs_by_stage(m.joint, m.packet, config).items():
            total[stage] += score(pairs, m.joint, m.packet, names, mistaken)
    return total


def _error(T_own_peer: Pose, T_true: Pose, centre: Array) -> tuple[float, float]:
    turn = so3_log(T_own_peer.R.T @ T_true.R)[2]
    return float(np.linalg.norm(T_own_peer.apply(centre) - T_true.apply(centre))), float(np.rad2deg(abs(turn)))


def _nees(alignment: Alignment, T_true: Pose) -> float:
    error = np.append(T_true.t - alignment.T_own_peer.t, so3_log(T_true.R @ alignment.T_own_peer.R.T)[2])
    return float(error @ np.linalg.solve(alignment.covariance, error)) / len(error)


def _scores(
    tracks: Mapping[str, tuple[Mapping[str, Trajectory], Flown]], judge: Callable[[Trajectory, Trajectory], float]
) -> dict[str, dict[str, float]]:
    return {
        name: {key: judge(found[name], flights.truths[name]) for key, (found, flights) in tracks.items()}
        for name in (OWN, PEER)
    }


def _pose_nees(estimate: Trajectory, truth: Trajectory) -> float:
    found = nees(estimate, truth)
    assert found is not None
    return summarise(found.position).mean


def _ate(estimate: Trajectory, truth: Trajectory) -> float:
    error = absolute_error(estimate, truth)
    assert error is not None  # the simulation has a truth for each frame
    return error.ate_m
