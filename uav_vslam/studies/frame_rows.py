# SPDX-License-Identifier: Apache-2.0
"""The study of unknown frames: how soon vehicles find where each other's map lies, how well, and what it is worth."""

from collections.abc import Callable, Sequence

from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.association_stages import Score, stage_rows
from uav_vslam.studies.frames import SHARES, FrameRun, run_seed
from uav_vslam.studies.pool import in_pool, mean, median, ratio, rms

FOUND_WITHIN_S = 30.0  # of overlap, which begins with the flight
TRACKS = ("alone", "unknown", "known")
MAX_ERROR_M, MAX_ERROR_DEG = 1.5, 1.0

NOTES = {
    "Flights": "two vehicles in formation at landmark level; the map frame of the second is turned by up to 180 "
    "degrees and shifted by 1 to 50 m, and a share of the landmarks that both map look like others of them to the "
    "second for the whole flight: wrong_matches is the wrong ones' share of the matches in the packet that gives the "
    "frame. Later fewer are wrong, for each vehicle then sends first what has proved to be shared",
    "Error": "of T_uav1_uav2 when it is found, against the transform that fits the two own-only maps of that moment "
    "best: least squares, without weights, over all landmarks that both maps hold, identities from the simulation; "
    "metres at those landmarks' centre. Later: root mean square over all packets until the end of the flight. Each "
    "map's own drift is inside both transforms; landmarks just mapped make the yardstick itself rough by decimetres",
    "Good": f"found within {FOUND_WITHIN_S:g} s, within {MAX_ERROR_M} m and {MAX_ERROR_DEG} degree",
    "NEES": "frame: of T_uav1_uav2 against the true frames, over 4, when it is found; pose: of the fused position of "
    "both vehicles, over 3, mean over the frames after the 20th",
    "ATE": "root mean square over the seeds, of the vehicle that is better alone, each in its own map frame; known: "
    "the same flights and the same mistakes in a common frame. It favours standing alone, for the better one of two is "
    "so by luck too; both: over both vehicles",
    "Stages": "pairs that uav1 finds in all packets of the flight, in a common frame but for the last row; recall is "
    "over the landmarks that both have and that look right",
}


def frame_rows(
    seeds: Sequence[int], *, frames: int, workers: int, on_seed: Callable[[], None] = lambda: None
) -> list[Row]:
    """Fly the study and return its tables: pooled by share of mistaken landmarks, by stage, and seed by seed."""
    runs: list[FrameRun] = []
    for found in in_pool(run_seed, [Scenario(seed=seed, frames=frames) for seed in seeds], workers):
        runs += found
        on_seed()
    runs.sort(key=lambda run: (run.share, run.seed))
    rows = [{TABLE: "unknown frames", **_pooled([run for run in runs if run.share == share])} for share in SHARES]
    rows += [{TABLE: "stages of association", **row} for row in stage_rows((run.share, run.stages) for run in runs)]
    return rows + [{TABLE: "seed by seed", **_single(run)} for run in runs if run.share > 0]


def is_good(run: FrameRun) -> bool:
    """Tell whether the frame was found in time and well."""
    if run.found_s is None:
        return False
    metres, degrees = run.errors[0]
    return bool(run.found_s <= FOUND_WITHIN_S and metres <= MAX_ERROR_M and degrees <= MAX_ERROR_DEG)


def _pooled(runs: Sequence[FrameRun]) -> Row:
    first = [run.errors[0] for run in runs if run.found_s is not None]
    later = [error for run in runs for error in run.errors]
    better = [min(run.ate_m.values(), key=lambda ate: ate["alone"]) for run in runs]
    both = [ate for run in runs for ate in run.ate_m.values()]
    alone, unknown, known = (rms([ate[key] for ate in better]) for key in TRACKS)
    both_alone, both_unknown, both_known = (rms([ate[key] for ate in both]) for key in TRACKS)
    matches = sum((run.matches for run in runs), Score())
    return {
        "mistaken": runs[0].share,
        "wrong_matches": ratio(matches.wrong, matches.left),
        "seeds": len(runs),
        "found": len(first),
        "good": sum(is_good(run) for run in runs),
        "median_found_s": median([run.found_s for run in runs if run.found_s is not None]),
        "median_error_m": median([metres for metres, _ in first]),
        "worst_error_m": max((metres for metres, _ in first), default=None),
        "worst_error_deg": max((degrees for _, degrees in first), default=None),
        "later_rms_m": rms([metres for metres, _ in later]),
        "later_rms_deg": rms([degrees for _, degrees in later]),
        "nees_frame": mean([run.nees for run in runs if run.nees is not None]),
        "nees_pose_unknown": mean([score["unknown"] for run in runs for score in run.pose_nees.values()]),
        "ate_alone_m": alone,
        "ate_ratio_unknown": ratio(unknown, alone),
        "ate_ratio_known": ratio(known, alone),
        "both_ratio_unknown": ratio(both_unknown, both_alone),
        "both_ratio_known": ratio(both_known, both_alone),
    }


def _single(run: FrameRun) -> Row:
    metres, degrees = run.errors[0] if run.found_s is not None else (None, None)
    return {
        "mistaken": run.share,
        "seed": run.seed,
        "found_s": run.found_s,
        "matches": run.matches.left,
        "wrong": run.matches.wrong,
        "used": run.used.left,
        "wrong_used": run.used.wrong,
        "error_m": metres,
        "error_deg": degrees,
        "good": is_good(run),
    }
