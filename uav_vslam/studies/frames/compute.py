# SPDX-License-Identifier: Apache-2.0
"""One seed's flights of two vehicles with unknown map transform: when it is found, and how accurately."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.alignment import Alignment
from uav_vslam.cooperation.common_landmarks import descriptor_matches
from uav_vslam.evaluation.consistency import nees, summarise
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.association_stages import (
    STAGES,
    UNKNOWN_FRAME,
    Identities,
    Pairs,
    Score,
    pairs_by_method,
    pairs_by_stage,
    score,
)
from uav_vslam.studies.engine.separate_frames import (
    OwnOnlyTracks,
    draw_offset,
    fly_own_only,
    in_other_frame,
    with_mistaken_landmarks,
)
from uav_vslam.studies.frames.map_baselines import alignment_error, map_to_map, weighted_map_to_map
from uav_vslam.studies.frames.meetings import Meeting, RecordingFusion, meet
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket

Array = NDArray[np.float64]
Metric = Callable[[Trajectory, Trajectory], float]
PairsByName = Callable[[JointInformation, LandmarkPacket, FusionConfig], dict[str, Pairs]]
ByVehicle = dict[str, dict[str, float]]  # figure by track and vehicle

OWN, PEER = "uav1", "uav2"
TRACKS = ("alone", "unknown", "known")  # the last two: together, the peer's frame unknown or known
SHARES = (0.0, 0.3, 0.5)


@dataclass(frozen=True, slots=True)
class FirstAlignment:
    """How the peer's frame was found.

    Attributes:
        after_s: since the first frame.
        matches: by ratio and mutual test in that packet.
        used: inliers of the alignment among them.
        to_weighted: its distance from `weighted_map_to_map` [m], [deg].
        to_true: its distance from the true frames, both maps' drift included [m], [deg].
        nees: of that distance, over 4.
    """

    after_s: float
    matches: Score
    used: Score
    to_weighted: tuple[float, float]
    to_true: tuple[float, float]
    nees: float


@dataclass(frozen=True, slots=True)
class FrameRun:
    """One seed with one share of mistaken landmarks.

    Attributes:
        seed, share: which.
        first: how the frame was found; None if it was not.
        errors: (P, 2) of each packet's alignment since then [m], [deg].
        ate_m, pose_nees: figures of `evaluation` by vehicle and track.
        stages: the pairs of uav1's that each stage of association keeps.
        methods: the pairs of uav1's that each method of association finds.
    """

    seed: int
    share: float
    first: FirstAlignment | None
    errors: Array
    ate_m: ByVehicle
    pose_nees: ByVehicle
    stages: dict[str, Score]
    methods: dict[str, Score]


def run_seed(scenario: Scenario) -> list[FrameRun]:
    """Fly one seed alone, then fuse its vehicles with each share of mistaken landmarks."""
    flown = fly_own_only(scenario)
    return [run_together(flown, scenario.seed, share) for share in SHARES]


def run_together(flown: OwnOnlyTracks, seed: int, share: float, *, feedback: bool = False) -> FrameRun:
    """Fuse two vehicles, in a common frame and with the peer's map moved at random."""
    T_peer_own, config = draw_offset(seed), FusionConfig(feedback=feedback)
    together, truth = with_mistaken_landmarks(flown, share, seed)
    moved = in_other_frame(together, PEER, T_peer_own)
    unknown_config = dataclasses.replace(config, common_origin=False)
    framing, common = ({name: RecordingFusion(name, c) for name in flown.tracks} for c in (unknown_config, config))
    unknown, known = meet(moved, framing), meet(together, common)
    tracks = {"alone": (_alone(moved), moved), "unknown": (unknown, moved), "known": (known, together)}
    aligned = [(m, m.alignment) for m in framing[OWN].meetings if m.alignment is not None]
    return FrameRun(
        seed=seed,
        share=share,
        first=_first(*aligned[0], T_peer_own.inverse(), moved, truth, config) if aligned else None,
        errors=_errors(aligned, moved, truth),
        ate_m=_scored_tracks(tracks, _ate),
        pose_nees=_scored_tracks(tracks, _pose_nees),
        stages={
            **dict.fromkeys(STAGES, Score()),
            **_totals(common[OWN].meetings, pairs_by_stage, truth, config),
            UNKNOWN_FRAME: sum((score(m.pairs, m.joint, m.packet, truth) for m in framing[OWN].meetings), Score()),
        },
        methods=_totals(common[OWN].meetings, pairs_by_method, truth, config),
    )


def _errors(aligned: Sequence[tuple[Meeting, Alignment]], flown: OwnOnlyTracks, truth: Identities) -> Array:
    errors = [
        alignment_error(alignment.T_own_peer, *map_to_map(*_whole_maps(m, flown), truth)) for m, alignment in aligned
    ]
    return np.array(errors).reshape(-1, 2)


def _whole_maps(meeting: Meeting, flown: OwnOnlyTracks) -> tuple[JointInformation, JointInformation]:
    """Return the own-only beliefs at a meeting: the receiver's, and the peer's at the packet's stamp."""
    maps = {o.joint.stamp_ns: o.joint for track in flown.tracks.values() for o in track.outputs if o.joint is not None}
    return maps[meeting.joint.stamp_ns], maps[meeting.packet.stamp_ns]


def _first(
    meeting: Meeting, alignment: Alignment, T_true: Pose, flown: OwnOnlyTracks, truth: Identities, config: FusionConfig
) -> FirstAlignment:
    T, maps = alignment.T_own_peer, _whole_maps(meeting, flown)
    error = np.append(T_true.t - T.t, so3_log(T_true.R @ T.R.T)[2])
    matches = descriptor_matches(meeting.joint.descriptors, meeting.packet, config.ratio)
    start_ns = flown.tracks[OWN].outputs[0].report.pose.stamp_ns
    centre = map_to_map(*maps, truth)[1]
    return FirstAlignment(
        after_s=(meeting.joint.stamp_ns - start_ns) / NS_PER_S,
        matches=score(matches, meeting.joint, meeting.packet, truth),
        used=score(meeting.pairs, meeting.joint, meeting.packet, truth),
        to_weighted=alignment_error(T, weighted_map_to_map(*maps, truth, config.floor_sigma_m), centre),
        to_true=alignment_error(T, T_true, centre),
        nees=float(error @ np.linalg.solve(alignment.covariance, error)) / len(error),
    )


def _totals(
    meetings: Sequence[Meeting], pairs_by_name: PairsByName, truth: Identities, config: FusionConfig
) -> dict[str, Score]:
    total: dict[str, Score] = {}
    for m in meetings:
        for name, pairs in pairs_by_name(m.joint, m.packet, config).items():
            total[name] = total.get(name, Score()) + score(pairs, m.joint, m.packet, truth)
    return total


def _alone(flown: OwnOnlyTracks) -> dict[str, Trajectory]:
    return {name: Trajectory.from_estimates(track.poses) for name, track in flown.tracks.items()}


def _scored_tracks(tracks: Mapping[str, tuple[Mapping[str, Trajectory], OwnOnlyTracks]], metric: Metric) -> ByVehicle:
    return {
        name: {key: metric(found[name], flown.truths[name]) for key, (found, flown) in tracks.items()}
        for name in (OWN, PEER)
    }


def _ate(estimate: Trajectory, truth: Trajectory) -> float:
    error = absolute_error(estimate, truth)
    assert error is not None  # the simulation has a truth for each frame
    return error.ate_m


def _pose_nees(estimate: Trajectory, truth: Trajectory) -> float:
    found = nees(estimate, truth)
    assert found is not None
    return summarise(found.position).mean
