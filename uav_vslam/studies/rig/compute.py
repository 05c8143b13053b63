# SPDX-License-Identifier: Apache-2.0
"""Rendered flights whose right camera vibrates, is turned or has another principal point; with the error as a state.

A bias about the axis that changes disparity scales all depths: it does not appear in the residuals,
so a filter with fixed calibration is over-confident in a wrong scale. As a state it is observable from the motion.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.summary import TRACK_NAMES
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.flight_rows import scores_of
from uav_vslam.studies.engine.flights import Method, Outcome, run_seed
from uav_vslam.studies.engine.pool import grouped, in_pool, mean, ratio
from uav_vslam.studies.engine.score_columns import pooled_scores, values_of
from uav_vslam.studies.engine.variants import CALIBRATIONS

INS, S_SLAM = "ins", "s_slam"  # the tracks of interest
RIGID = "rigid"
VIBRATIONS_DEG = (0.02, 0.05)  # rms about each axis, new in each frame
BIASES_DEG = (0.02, 0.05)  # constant, about one axis
DISPARITIES_PX = (0.2, 0.3)  # constant
# The Kagaru rig's baseline is along the image's vertical: turning about x changes disparity, about y it moves points
# off their epipolar lines.
AXES = ("x (disparity)", "y (epipolar)", "z (optical)")

NOTES = {
    "Rig": "the right camera's true attitude away from the calibration that the vehicle is given: vibration is drawn "
    "for each frame, rms about each axis; a bias is constant. Axes are the right camera's: about x its points "
    "move along the disparity, about y off their epipolar lines, z is the optical axis. With a disparity error its "
    "principal point is off along the disparity",
    "Methods": "; ".join(
        f"{name}: {key} = {value}" for name, keys in CALIBRATIONS.items() for key, value in keys.items()
    ),
    "Errors": "root mean squares over the seeds at the end and over the flight, in the common frame without alignment; "
    "end_ratio_to_rigid is over the first method's on the rigid rig",
    "NEES": "of the position, over 3, mean over the frames after the 20th and over the seeds: 1 is consistent",
}

Job = tuple[list[Method], int]


def conditions(scenario: Scenario) -> dict[str, Scenario]:
    """Return the flights of the study by name, the rigid rig's first."""
    found = {RIGID: scenario}
    for vibration in VIBRATIONS_DEG:
        found[f"vibration {vibration} deg"] = dataclasses.replace(scenario, vibration_deg=vibration)
    for bias in BIASES_DEG:
        for axis, name in enumerate(AXES):
            x, y, z = (bias * (axis == k) for k in range(3))
            found[f"bias {bias} deg about {name}"] = dataclasses.replace(scenario, extrinsic_bias_deg=(x, y, z))
    for shift_px in DISPARITIES_PX:
        found[f"disparity error {shift_px} px"] = dataclasses.replace(scenario, disparity_bias_px=shift_px)
    return found


def run_study(
    scenario: Scenario,
    configs: Mapping[str, VehicleConfig],
    seeds: Sequence[int],
    *,
    workers: int,
    on_flight: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Fly everything on every seed and return the rows of `study.json`: the INS, then all methods by condition.

    Args:
        scenario: the flight with a rigid rig; its seed is replaced.
        configs: of the vehicle, by method; on the rigid rig the first one is the reference for the others.
        seeds: of the flights.
        workers: processes.
        on_flight: called when one condition of one seed has been rendered and flown.
    """
    compared = [
        [Method(name, condition, flight, config, rendered=True) for name, config in configs.items()]
        for condition, flight in conditions(scenario).items()
    ]
    jobs: list[Job] = [(methods, seed) for seed in seeds for methods in compared]
    outcomes = [outcome for found in in_pool(_fly, jobs, workers, on_flight) for outcome in found]
    return _rows(grouped(outcomes, lambda outcome: outcome.method))


def _fly(job: Job) -> list[Outcome]:
    methods, seed = job
    return run_seed(methods, seed)


def _rows(flown: Mapping[Method, Sequence[Outcome]]) -> list[Row]:
    rows: list[Row] = [{"condition": "any", "method": TRACK_NAMES[INS], **_figures(next(iter(flown.values())), INS)}]
    for method, outcomes in flown.items():
        label = f"{TRACK_NAMES[S_SLAM]}, {method.name}"
        rows.append({"condition": method.condition, "method": label, **_figures(outcomes, S_SLAM)})
    reference = rows[1]["end_rms_m"]
    return [{**row, "end_ratio_to_rigid": ratio(row["end_rms_m"], reference)} for row in rows]


def _figures(outcomes: Sequence[Outcome], track: str) -> Row:
    """Pool one track over the seeds; the INS's covariance is not scored, and it leaves no frame out."""
    good = [outcome for outcome in outcomes if outcome.figures]
    figures = pooled_scores(scores_of(good, track))
    if track == INS:
        return figures
    return {
        **figures,
        "nees_position_end": mean(values_of(scores_of(good, track), "nees_position_end")),
        "processed_share": mean([outcome.processed for outcome in good]),
        "failures": len(outcomes) - len(good),
        "runs": len(outcomes),
        "ms_per_frame": mean([outcome.ms_per_frame for outcome in good]),
    }
