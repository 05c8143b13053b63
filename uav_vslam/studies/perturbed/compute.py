# SPDX-License-Identifier: Apache-2.0
"""Flights whose vehicle assumes a slightly wrong calibration, beside the same flights with the exact one.

The world and the cameras are the same in all conditions; only what front end, filter and clock assume differs.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flight_rows import nees_series, scores_of
from uav_vslam.studies.engine.flights import Method, Outcome, fly_sources
from uav_vslam.studies.engine.pool import in_pool, mean, mean_interval, ratio, ratio_interval, rms
from uav_vslam.studies.engine.score_columns import pooled_scores, values_of
from uav_vslam.studies.perturbed.calibration import CONDITIONS, EXACT, errors_of
from uav_vslam.types import NS_PER_S, StereoFeatures, StereoFrame
from uav_vslam.vision.frontends import make_frontend

LANDMARKS, RENDERED = "landmark level", "rendered images"
S_SLAM = "s_slam"

NOTES = {
    "Flights": "one vehicle alone, config kagaru, ADIS16480; at landmark level pixels have white noise of "
    "backend.sigma_px. All conditions of a seed share flight, landmarks, images and noise",
    "Conditions": "what the vehicle assumes differs from the truth, drawn for each seed with the standard deviation "
    "named: focal length of each camera, principal point of each camera and coordinate, attitude about each axis, "
    "baseline, clock of the cameras; then all of these, independent of each other. Errors of the disparity are "
    "the same for all seeds. The last is the rig as "
    "`uav-vslam calibrate` finds it from simulated corners of a board with 0.15 px of noise: correlated errors",
    "Ratio": "ratio_to_exact is the ATE over that of the same method and seeds with the exact calibration, with the "
    "bootstrap's interval over seeds",
    "NEES": "over 3, mean over the frames after the 20th and over the seeds: 1 is consistent, more over-confident",
}

Job = tuple[str, Scenario, tuple[tuple[str, VehicleConfig], ...]]
Frames = tuple[StereoFeatures | StereoFrame, ...]


def run_study(
    configs: Mapping[str, VehicleConfig],
    levels: Mapping[str, Sequence[int]],
    *,
    frames: int,
    workers: int,
    on_seed: Callable[[], None] = lambda: None,
) -> tuple[list[Row], list[Row]]:
    """Fly everything; return rows, and NEES over time.

    Args:
        configs: of the vehicle, by method.
        levels: seeds at LANDMARKS and RENDERED.
        frames: of each flight.
        workers: processes.
        on_seed: called when all conditions of one seed have been flown.
    """
    scenario = Scenario(frames=frames, vehicles=1)
    jobs: list[Job] = [
        (level, dataclasses.replace(scenario, seed=seed), tuple(configs.items()))
        for level, seeds in sorted(levels.items(), key=lambda item: item[0] != RENDERED)  # the longest first
        for seed in seeds
    ]
    found = [outcome for outcomes in in_pool(fly_seed, jobs, workers, on_seed) for outcome in outcomes]
    rows: list[Row] = []
    series: list[Row] = []
    for level, rendered in ((LANDMARKS, False), (RENDERED, True)):
        here = [outcome for outcome in found if outcome.method.rendered == rendered]
        rows += [{TABLE: level, **row} for row in _rows(here)]
        curves = nees_series(list(dict.fromkeys(outcome.method for outcome in here)), here)
        series += [{TABLE: level, **curve} for curve in curves]
    return rows, series


def fly_seed(job: Job) -> list[Outcome]:
    """Fly one seed with every calibration, by all methods."""
    level, scenario, configs = job
    vehicle = simulate_vehicle(scenario, 0)
    seen: dict[tuple[float, float], Frames] = {}
    outcomes = []
    for condition, error in errors_of(scenario.seed).items():
        assumed = dataclasses.replace(vehicle, rig=error.applied(vehicle.rig))
        for name, config in configs:
            key = error.time_offset_s, 0.0 if level == RENDERED else config.backend.sigma_px
            if key not in seen:
                seen[key] = tuple(_stamped_wrongly(vehicle, error.time_offset_s, level, key[1]))
            features = tuple(_features(assumed, config, seen[key]))
            method = Method(name, condition, dataclasses.replace(scenario, seed=0), config, rendered=level == RENDERED)
            outcomes.append(fly_sources(method, scenario, [assumed], [SimulatedSource(assumed, features=features)]))
    return outcomes


def _stamped_wrongly(
    vehicle: SimulatedVehicle, time_offset_s: float, level: str, sigma_px: float
) -> Iterable[StereoFeatures | StereoFrame]:
    """Yield what the true rig sees a little before the assumed stamps, by the time offset."""
    stamps_ns = vehicle.frame_stamps_ns
    true = dataclasses.replace(vehicle, frame_stamps_ns=stamps_ns - round(time_offset_s * NS_PER_S))
    landmarks = scatter_landmarks([vehicle])
    frames: Iterable[StereoFeatures | StereoFrame] = (
        RenderedFlight(true)
        if level == RENDERED
        else (features for features, _ in observe(true, landmarks, noise=LandmarkNoise(sigma_px=sigma_px)))
    )
    for stamp_ns, frame in zip(stamps_ns.tolist(), frames, strict=True):
        yield dataclasses.replace(frame, stamp_ns=stamp_ns)


def _features(assumed: SimulatedVehicle, config: VehicleConfig, frames: Frames) -> Iterable[StereoFeatures]:
    """Yield what the front end finds with the assumed rig in images, and simulated features as its lenses undistort.

    The true lenses have no distortion, so that simulated pixels are raw ones, too.
    """
    frontend = make_frontend(assumed.rig, config.frontend, config.rig)
    for frame in frames:
        if isinstance(frame, StereoFrame):
            yield frontend.process(frame)
            continue
        left, right = assumed.rig.left.undistort(frame.pixels[:, :2]), assumed.rig.right.undistort(frame.pixels[:, 2:])
        yield dataclasses.replace(frame, pixels=np.hstack([left, right]).astype(np.float32))


def _rows(outcomes: Sequence[Outcome]) -> list[Row]:
    names = dict.fromkeys(outcome.method.name for outcome in outcomes)
    flown = {
        (name, condition): [o for o in outcomes if (o.method.name, o.method.condition) == (name, condition)]
        for name in names
        for condition in CONDITIONS
    }
    return [
        {"method": name, "condition": condition, **_figures(found, flown[name, EXACT])}
        for (name, condition), found in flown.items()
    ]


def _figures(outcomes: Sequence[Outcome], exact: Sequence[Outcome]) -> Row:
    """Pool the seeds, and compare those that were flown to the end with both calibrations."""
    scores, before = (
        {outcome.seed: scores_of([outcome], S_SLAM)[0] for outcome in some if outcome.figures}
        for some in (outcomes, exact)
    )
    common = sorted(set(scores) & set(before))
    own, other = (np.array([found[seed]["ate_m"] ** 2 for seed in common]) for found in (before, scores))
    nees = np.array(values_of(list(scores.values()), "nees_position"))
    return {
        **pooled_scores(list(scores.values())),
        **mean_interval("nees_position", nees),
        "nees_position_worst": max(nees.tolist(), default=None),
        "ratio_to_exact": ratio(rms(np.sqrt(other).tolist()), rms(np.sqrt(own).tolist())),
        **ratio_interval(own, other),
        "failures": len(outcomes) - len(scores),
        "runs": len(outcomes),
        "ms_per_frame": mean([outcome.ms_per_frame for outcome in outcomes if outcome.figures]),
    }
