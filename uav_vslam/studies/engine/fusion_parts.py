# SPDX-License-Identifier: Apache-2.0
"""Tables of cooperation settings: what each gains, and whether it stays consistent."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.simulation.landmarks import LandmarkNoise
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.cooperation import Outcome, Setting, run_settings
from uav_vslam.studies.engine.pool import CONFIDENCE, in_pool, mean, ratio_interval, root_mean
from uav_vslam.studies.engine.scores import nees_figures

Array = NDArray[np.float64]

PARTED_S = 65.0  # of the scenario "parting": from then on the vehicles never see the same ground again
LASTING_S = 60.0  # after that, the gain is measured again
PARTING_S = (60.0, 75.0)  # while they part, no correction may jump

NOTES = {
    "Tables": "own-only tracks are computed once a seed, so all rows of a table have the same flights",
    "Ratio": "ATE, root mean square over seeds and vehicles, over that of the same vehicles alone; ratio_low and "
    f"ratio_high: {CONFIDENCE:.0%} of the bootstrap over seeds",
    "Channel": "content sent over the radio: own maps hold only the sender's measurements, fused maps also those of "
    "peers; feedback returns each peer's landmarks as fused; relays forward packets unchanged",
    "NEES": "of the position over 3, mean over keyframes after the 20th, seeds and vehicles; 1 is consistent. Low and "
    f"high: {CONFIDENCE:.0%} of the bootstrap over seeds; worst quarter: the largest mean of a quarter of the flight; "
    "outside: the share of runs whose mean over time is outside of the 95 % chi-square band of one NEES, 0.07 to 3.1; "
    "errors of a run are correlated, so that a consistent filter leaves it in 5 % of the runs at most",
    "Failures": "runs (a seed and vehicle) whose covariance lost definiteness or whose filter failed; their errors "
    "do not count",
}
PARTING_NOTES = {
    "lasting_ratio_to_s_slam": f"from {LASTING_S:.0f} s after the last common view on",
    "largest_jump_sigmas": "while they part",
    "recovery_packets": "sent after the blackout until one was used, at worst",
}


@dataclasses.dataclass(frozen=True, slots=True)
class Part:
    """One table: a flight and its cooperation settings; `mistaken_share` as in `run_settings`."""

    table: str
    scenario: Scenario
    settings: tuple[Setting, ...]
    config: VehicleConfig = dataclasses.field(default_factory=VehicleConfig)
    noise: LandmarkNoise = dataclasses.field(default_factory=LandmarkNoise)
    mistaken_share: float = 0.0


def run_parts(
    parts: Sequence[Part], seeds: Sequence[int], *, workers: int, on_job: Callable[[], None] = lambda: None
) -> list[Row]:
    """Fly every part on every seed, a job each; return a row for each part and setting."""
    jobs = [(part, seed) for part in parts for seed in seeds]
    outcomes: dict[str, list[Outcome]] = {part.table: [] for part in parts}
    for table, found in in_pool(_job, jobs, workers, on_job):
        outcomes[table] += found
    return [
        {
            TABLE: part.table,
            "method": setting.name,
            "condition": part.table,
            "channel": setting.channel(part.config.fusion),
            **_figures(part, _of(outcomes[part.table], setting)),
        }
        for part in parts
        for setting in part.settings
    ]


def _job(job: tuple[Part, int]) -> tuple[str, list[Outcome]]:
    part, seed = job
    scenario = dataclasses.replace(part.scenario, seed=seed)
    found = run_settings(scenario, part.settings, part.config, part.noise, mistaken_share=part.mistaken_share)
    return part.table, found


def _of(outcomes: Sequence[Outcome], setting: Setting) -> list[Outcome]:
    return sorted((o for o in outcomes if o.setting == setting.name), key=lambda o: (o.seed, o.vehicle))


def _figures(part: Part, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    good = [o for o in outcomes if not o.failure]
    own, fused = _squares(good, "own_error"), _squares(good, "error")
    row: dict[str, Any] = {
        "s_slam_ate_rms_m": root_mean(own),
        "ate_rms_m": root_mean(fused),
        "ratio_to_s_slam": _ratio(own, fused),
        **ratio_interval(own, fused),
        "s_slam_nees_position": nees_figures([(o.seed, o.own_nees) for o in good])["nees_position"],
        **nees_figures([(o.seed, o.nees) for o in good]),
        "failures": len(outcomes) - len(good),
        "runs": len(outcomes),
    }
    if part.scenario.pattern == "parting":
        late = PARTED_S + LASTING_S
        row["lasting_ratio_to_s_slam"] = _ratio(_squares(good, "own_error", late), _squares(good, "error", late))
        row["largest_jump_sigmas"] = max((_largest_jump(o) for o in good), default=None)
        row["recovery_packets"] = max((o.figures["recovery_packets"] for o in good), default=None)
    for key in ("sent_bytes_per_s", "ms_per_epoch"):
        row[key] = mean([o.figures[key] for o in good if key in o.figures])
    for key in ("packet_bytes_max", "lambda_excess"):
        row[key] = max((o.figures[key] for o in good if key in o.figures), default=None)
    return row


def _squares(outcomes: Sequence[Outcome], key: str, from_s: float = 0.0) -> Array:
    """Return (S,) mean squared errors of each seed, over its vehicles and frames [m^2]."""
    seeds = sorted({o.seed for o in outcomes})
    of_runs = [(o.seed, float(np.mean(getattr(o, key)[o.times_s >= from_s] ** 2))) for o in outcomes]
    return np.array([np.mean([square for seed, square in of_runs if seed == wanted]) for wanted in seeds])


def _ratio(own: Array, fused: Array) -> float | None:
    return float(np.sqrt(fused.mean() / own.mean())) if len(own) else None


def _largest_jump(outcome: Outcome) -> float:
    parting = (outcome.times_s >= PARTING_S[0]) & (outcome.times_s <= PARTING_S[1])
    steps = np.linalg.norm(np.diff(outcome.correction[parting], axis=0), axis=1)
    return float(np.max(steps / outcome.sigma[parting][1:]))
