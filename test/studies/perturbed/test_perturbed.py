# SPDX-License-Identifier: Apache-2.0
"""The world stays the same: only what the vehicle assumes differs."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flights import Method, Outcome, fly_sources, kagaru_configs
from uav_vslam.studies.perturbed import compute
from uav_vslam.studies.perturbed.calibration import CONDITIONS, EXACT
from uav_vslam.studies.perturbed.compute import LANDMARKS, RENDERED, fly_seed, run_study

pytestmark = pytest.mark.slow

FRAMES = 25
CONFIGS = kagaru_configs({"fixed": {}})
BASELINE = next(name for name in CONDITIONS if name.startswith("baseline"))


@pytest.fixture(scope="module")
def scenario():
    return Scenario(frames=FRAMES, vehicles=1, seed=3)


@pytest.fixture(scope="module")
def flown(scenario):
    return {o.method.condition: o for o in fly_seed((LANDMARKS, scenario, tuple(CONFIGS.items())))}


def ate_m(outcome):
    return outcome.figures["s_slam"]["uav1"]["ate_m"]


def test_the_exact_calibration_flies_as_the_plain_flight_does(scenario, flown):
    vehicle, config = simulate_vehicle(scenario, 0), CONFIGS["fixed"]
    source = SimulatedSource(vehicle, scatter_landmarks([vehicle]), LandmarkNoise(sigma_px=config.backend.sigma_px))
    plain = fly_sources(Method("fixed", EXACT, scenario, config), scenario, [vehicle], [source])
    assert ate_m(flown[EXACT]) == ate_m(plain)


def test_every_condition_is_flown_and_each_error_changes_the_estimate(flown):
    assert list(flown) == list(CONDITIONS)
    assert len({ate_m(outcome) for outcome in flown.values()}) == len(CONDITIONS)


def test_a_time_offset_shows_the_world_of_before_under_the_told_stamps(scenario):
    vehicle = simulate_vehicle(scenario, 0)
    seen = list(compute._stamped_wrongly(vehicle, 0.02, LANDMARKS, 0.0))
    assert [frame.stamp_ns for frame in seen] == vehicle.frame_stamps_ns.tolist()
    earlier = dataclasses.replace(vehicle, frame_stamps_ns=vehicle.frame_stamps_ns - 20_000_000)
    expected = observe(earlier, scatter_landmarks([vehicle]), noise=LandmarkNoise(sigma_px=0.0))
    for frame, (features, _) in zip(seen, expected, strict=True):
        np.testing.assert_array_equal(frame.pixels, features.pixels)


def test_both_levels_have_a_row_and_a_curve_for_each_condition():
    rows, series = run_study(CONFIGS, {LANDMARKS: [1, 2], RENDERED: [1]}, frames=2, workers=1)
    labels = [(row["table"], row["condition"]) for row in rows]
    assert labels == [(level, condition) for level in (LANDMARKS, RENDERED) for condition in CONDITIONS]
    assert [row["runs"] for row in rows] == [2] * len(CONDITIONS) + [1] * len(CONDITIONS)
    assert {row["ratio_to_exact"] for row in rows if row["condition"] == EXACT} == {1.0}
    assert [(curve["table"], curve["condition"]) for curve in series] == labels


def test_only_seeds_that_both_calibrations_finish_are_compared():
    method = Method("fixed", EXACT, Scenario(), CONFIGS["fixed"])

    def outcome(condition, seed, ate):
        figures = None if ate is None else {"s_slam": {"uav1": {"ate_m": ate, "nees_position": 1.0}}}
        return Outcome(dataclasses.replace(method, condition=condition), seed, figures, 1.0)

    wrong = [outcome(BASELINE, 1, 3.0), outcome(BASELINE, 2, None), outcome(BASELINE, 3, 50.0)]
    exact = [outcome(EXACT, 1, 2.0), outcome(EXACT, 2, 1.0), outcome(EXACT, 3, None)]
    (row,) = (row for row in compute._rows([*exact, *wrong]) if row["condition"] == BASELINE)
    assert row["ratio_to_exact"] == pytest.approx(1.5)
    assert (row["failures"], row["runs"]) == (1, 3)
