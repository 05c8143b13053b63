# SPDX-License-Identifier: Apache-2.0
"""The study of unknown frames: time to find the transform between maps, its accuracy, and the gain from it."""

from collections.abc import Callable, Sequence

from uav_vslam.config import FUSION_ASSOCIATIONS
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.association_stages import Score, mistaken_condition, stage_rows
from uav_vslam.studies.engine.pool import in_pool, mean, median, ratio, rms
from uav_vslam.studies.frames.compute import SHARES, TRACKS, FrameRun, run_seed

ALIGNMENT = "frame of the peer"
LABELS = {"alone": "S-SLAM", "unknown": "C-SLAM, frame unknown", "known": "C-SLAM, frame known"}  # by track
FOUND_WITHIN_S = 30.0  # of overlap, which starts with the flight
MAX_ERROR_M, MAX_ERROR_DEG = 1.5, 1.0

NOTES = {
    "Flights": "two vehicles in formation at landmark level; the map frame of the second is turned by up to 180 "
    "degrees and shifted by 1 to 50 m, and a share of the landmarks that both map has descriptors of others for the "
    "second for the whole flight: wrong_share is the wrong ones' share of the matches in the packet that gives the "
    "frame. Later fewer are wrong, because each vehicle then sends known shared landmarks first",
    "Error": "of T_uav1_uav2 when it is found, against the transform that fits the two own-only maps of that moment "
    "best: least squares, without weights, over all landmarks that both maps hold, identities from the simulation; "
    "metres at those landmarks' centre. Later: root mean square over all packets until the end of the flight. Each "
    "map's own drift is in both transforms. Landmarks just mapped have full weight, which makes this reference "
    "uncertain by up to a metre; weighted: against the fit over the same landmarks by the covariances of both maps",
    "True": "against the true frames, so with both maps' drift",
    "Good": f"found within {FOUND_WITHIN_S:g} s, within {MAX_ERROR_M} m and {MAX_ERROR_DEG} degree",
    "NEES": "frame: of T_uav1_uav2 against the true frames, over 4, when it is found; others: of both vehicles' "
    "position, over 3, mean over the frames after the 20th",
    "Trajectories": "alone, and together with the peer's frame unknown or known: the same flights and the same "
    "mismatches in a common frame. ATE is the root mean square over seeds and vehicles, each in its own frame, ratios "
    "are to S-SLAM; better: only the vehicle of each seed that is better alone, partly by chance",
    "Stages": "pairs that uav1 finds in all packets of the flight, in a common frame but for the last row; recall is "
    "over the landmarks that both have and whose descriptor is right",
    "Methods": "the same of each method of association in a common frame, on the packets that the default leads to; "
    "what wrong pairs cost is in `study fusion --parts association`",
}


def frame_rows(
    seeds: Sequence[int], *, frames: int, workers: int, on_seed: Callable[[], None] = lambda: None
) -> list[Row]:
    """Fly the study and return its tables: pooled by share of mistaken landmarks, by stage, and seed by seed."""
    scenarios = [Scenario(seed=seed, frames=frames) for seed in seeds]
    runs = [run for found in in_pool(run_seed, scenarios, workers, on_seed) for run in found]
    runs.sort(key=lambda run: (run.share, run.seed))
    by_share = [[run for run in runs if run.share == share] for share in SHARES]
    stages = stage_rows((run.share, run.stages) for run in runs)
    methods = stage_rows(((run.share, run.methods) for run in runs), FUSION_ASSOCIATIONS)
    return [
        *({TABLE: "frame of the peer's map", **_pooled(some)} for some in by_share),
        *({TABLE: "trajectories", **row} for some in by_share for row in _trajectories(some)),
        *({TABLE: "stages of association", **row} for row in stages),
        *({TABLE: "methods of association, fusion.association", **row} for row in methods),
        *({TABLE: "seed by seed", **_single(run)} for run in runs if run.share > 0),
    ]


def is_good(run: FrameRun) -> bool:
    """Return whether the frame was found in time and accurately."""
    if run.first is None:
        return False
    metres, degrees = run.errors[0]
    return bool(run.first.after_s <= FOUND_WITHIN_S and metres <= MAX_ERROR_M and degrees <= MAX_ERROR_DEG)


def _pooled(runs: Sequence[FrameRun]) -> Row:
    found = [(run.first, *run.errors[0]) for run in runs if run.first is not None]
    matches = sum((first.matches for first, _, _ in found), Score())
    later = [error for run in runs for error in run.errors]
    return {
        "method": ALIGNMENT,
        "condition": mistaken_condition(runs[0].share),
        "wrong_share": ratio(matches.wrong, matches.left),
        "runs": len(runs),
        "found": len(found),
        "good": sum(is_good(run) for run in runs),
        "found_median_s": median([first.after_s for first, _, _ in found]),
        "error_median_m": median([metres for _, metres, _ in found]),
        "error_worst_m": max((metres for _, metres, _ in found), default=None),
        "error_worst_deg": max((degrees for _, _, degrees in found), default=None),
        "later_rms_m": rms([metres for metres, _ in later]),
        "later_rms_deg": rms([degrees for _, degrees in later]),
        "weighted_worst_m": max((first.to_weighted[0] for first, _, _ in found), default=None),
        "true_worst_m": max((first.to_true[0] for first, _, _ in found), default=None),
        "true_worst_deg": max((first.to_true[1] for first, _, _ in found), default=None),
        "nees_frame": mean([first.nees for first, _, _ in found]),
    }


def _trajectories(runs: Sequence[FrameRun]) -> list[Row]:
    """Return a row per track."""
    both = [ate for run in runs for ate in run.ate_m.values()]
    better = [min(run.ate_m.values(), key=lambda ate: ate["alone"]) for run in runs]
    pooled, best = ({key: rms([ate[key] for ate in some]) for key in TRACKS} for some in (both, better))
    return [
        {
            "method": label,
            "condition": mistaken_condition(runs[0].share),
            "ate_rms_m": pooled[track],
            "ratio_to_s_slam": ratio(pooled[track], pooled["alone"]),
            "better_ate_rms_m": best[track],
            "better_ratio_to_s_slam": ratio(best[track], best["alone"]),
            "nees_position": mean([nees[track] for run in runs for nees in run.pose_nees.values()]),
        }
        for track, label in LABELS.items()
    ]


def _single(run: FrameRun) -> Row:
    labels = {"method": ALIGNMENT, "condition": mistaken_condition(run.share)}
    row: Row = {**labels, "seed": run.seed, "good": is_good(run)}
    if run.first is None:
        return row
    first, (metres, degrees) = run.first, run.errors[0]
    return {
        **row,
        "found_s": first.after_s,
        "matches": first.matches.left,
        "wrong": first.matches.wrong,
        "used": first.used.left,
        "wrong_used": first.used.wrong,
        "error_m": metres,
        "error_deg": degrees,
        "weighted_m": first.to_weighted[0],
        "true_m": first.to_true[0],
        "true_deg": first.to_true[1],
    }
