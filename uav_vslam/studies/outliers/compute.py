# SPDX-License-Identifier: Apache-2.0
"""Wrong matches: their effect on a vehicle alone, with each setting of the back end."""

from collections.abc import Mapping, Sequence
from typing import Any

from uav_vslam.evaluation.study import Row
from uav_vslam.simulation.landmarks import LOOKALIKE_PX, LandmarkNoise
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.own_only import Run, Trial, own_only
from uav_vslam.studies.engine.pool import grouped, ratio
from uav_vslam.studies.engine.scores import FAILURE_RULE, pooled

SHARES = (0.0, 0.05, 0.1, 0.2)
KINDS = {"swapped": "wrong_share", "lookalike": "lookalike_share"}  # what makes them, in `LandmarkNoise`
CLEAN = "clean"
ROBUST: dict[str, dict[str, Any]] = {f"backend.robust={on}": {"backend.robust": on} for on in (True, False)}

NOTES = {
    "Runs": "one vehicle alone on one seed at landmark level, 1 px, ADIS16480; wrong matches are drawn for each "
    "frame, the same for all settings",
    "Kinds": "swapped: features exchange their places in the image; lookalike: a feature is a real point "
    f"{LOOKALIKE_PX[0]:.0f} to {LOOKALIKE_PX[1]:.0f} px beside, in any direction of image and disparity together",
    "Ratio": "end_ratio_to_clean is over the end error of the same setting",
    "Failures": FAILURE_RULE,
}


def outlier_trials(variants: Mapping[str, dict[str, Any]], *, frames: int = 160, vehicles: int = 2) -> list[Trial]:
    """The default flight without wrong matches, then with a growing share of each kind.

    Args:
        variants: settings to compare, by name.
        frames: of each vehicle.
        vehicles: of each seed, each alone.
    """
    candidates = tuple(own_only(name, overrides) for name, overrides in variants.items())
    scenario = Scenario(frames=frames, vehicles=vehicles)
    return [Trial(condition, scenario, candidates, noise) for condition, noise in _conditions().items()]


def outlier_rows(runs: Sequence[Run]) -> list[Row]:
    """Return a row per setting, kind and share."""
    rows: list[Row] = []
    for name, of_name in grouped(runs, lambda run: run.name).items():
        clean = None
        for condition, flown in grouped(of_name, lambda run: run.condition).items():
            found = pooled(flown)
            clean = found["end_rms_m"] if condition == CLEAN else clean
            kind, _, share = condition.partition(" ")
            figures = {**found, "end_ratio_to_clean": ratio(found["end_rms_m"], clean)}
            labels = {"method": name, "condition": condition, "kind": kind, "wrong_match_share": float(share or 0.0)}
            rows.append({**labels, **figures})
    return rows


def _conditions() -> dict[str, LandmarkNoise]:
    found = {CLEAN: LandmarkNoise()}
    for kind, key in KINDS.items():
        found |= {f"{kind} {share}": LandmarkNoise(**{key: share}) for share in SHARES if share > 0}
    return found
