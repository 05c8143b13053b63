# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest

from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.slam.landmark_map import LONG_FRAMES
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.studies.revisit.compute import (
    FALSE_BEYOND_M,
    FORGETTING,
    LANDMARK,
    RENDERED,
    Loop,
    RevisitChecker,
    revisit_jobs,
    revisit_loops,
)
from uav_vslam.studies.revisit.rows import RETURN_M, back_at, revisit_rows, revisit_series


@dataclasses.dataclass
class Report:
    """The part of a frame's report that the checker reads."""

    sightings: np.ndarray


def loop(make_run, name, end_m, *, seed, false=()):
    return Loop(LANDMARK, make_run(name, end=(end_m, 0.0, 0.0), seed=seed), np.array(false, bool))


def test_the_flight_is_back_at_its_start_after_two_kilometres():
    truth = true_trajectory(simulate_vehicle(SCENARIOS["revisit"], 0))
    flown_m = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1))]
    assert flown_m[back_at(truth)] == pytest.approx(2050.0 - RETURN_M, abs=30.0)
    assert np.linalg.norm(truth.positions[:, :2] - truth.positions[0, :2], axis=1)[back_at(truth) :].min() < 10.0
    assert flown_m[-1] > 2100.0


def test_images_and_points_by_their_seeds_and_every_method_among_them():
    jobs = revisit_jobs({"one": {"backend.chance_revisits": 1.0}}, [1, 2], [1], frames=20)
    assert [(job.level, job.scenario.seed, job.scenario.frames) for job in jobs] == [
        (LANDMARK, 1, 20),
        (LANDMARK, 2, 20),
        (RENDERED, 1, 20),
    ]
    assert [(name, c.backend.chance_revisits, c.backend.retention) for name, c in jobs[0].configs.items()] == [
        ("one", 1.0, "grid"),
        (FORGETTING, 0.05, "none"),
    ]
    assert (jobs[0].configs["one"].backend.sigma_px, jobs[2].configs["one"].backend.sigma_px) == (1.0, 0.3)  # kagaru


@pytest.mark.parametrize(
    ("first", "then", "false"),
    [
        (-1, [[-1, 0.0, 2 * FALSE_BEYOND_M, 0.0], [-1, 9.0, 0.0, 0.0]], True),
        (-1, [[-1, 0.0, 0.5 * FALSE_BEYOND_M, 0.0], [-1, 9.0, 0.0, 0.0]], False),
        (3, [[3, 0.0, 2 * FALSE_BEYOND_M, 0.0], [4, 0.0, 0.0, 0.0]], False),
        (3, [[4, 0.0, 0.0, 0.0], [3, 0.0, 0.0, 0.0]], True),
        (3, [[-1, 0.0, 2 * FALSE_BEYOND_M, 0.0], [3, 0.0, 0.0, 0.0]], True),
    ],
)
def test_the_witness_knows_which_closures_are_false(first, then, false):
    checker = RevisitChecker(
        [np.array([[first, 0.0, 0.0, 0.0]]), *[np.zeros((0, 4))] * (LONG_FRAMES - 1), np.array(then)]
    )
    checker.add(Report(np.array([[7, 0]])))
    for _ in range(LONG_FRAMES - 1):
        checker.add(Report(np.zeros((0, 2), int)))
    checker.add(Report(np.array([[7, 0], [8, 1]])))  # 8 is new
    assert checker.false == [false]


def test_ends_are_compared_seed_by_seed_and_false_closures_are_counted(make_run):
    loops = [
        loop(make_run, name, end_m, seed=seed, false=false)
        for seed in (1, 2, 3)
        for name, end_m, false in (("retained", 1.0, [False, seed < 3] if seed > 1 else [True]), (FORGETTING, 4.0, []))
    ]
    kept, without = revisit_rows(loops)
    assert (kept["end_ratio_to_forgetting"], without["end_ratio_to_forgetting"]) == (pytest.approx(0.25), 1.0)
    assert kept["ratio_low"] == pytest.approx(0.25)
    assert (kept["closed"], kept["closures"], kept["false_closures"]) == (2, pytest.approx(5 / 3), 2)
    assert (without["closed"], without["closures"], without["false_closures"]) == (0, 0.0, 0)
    curves = revisit_series(loops)
    assert [curve["ends_m"] for curve in curves] == [[1.0] * 3, [4.0] * 3]
    assert curves[1]["error_m"][-1] == pytest.approx(4.0)


def test_both_methods_see_the_same_flight_of_each_level():
    frames = []
    jobs = revisit_jobs({}, [1], [1], frames=3)
    loops = revisit_loops(jobs, workers=1, on_frame=lambda: frames.append(1))
    assert [(x.level, x.run.name) for x in loops] == [
        (level, name) for level in (LANDMARK, RENDERED) for name in ("retained", FORGETTING)
    ]
    assert len(frames) == 6
    for kept, without in (loops[:2], loops[2:]):
        np.testing.assert_array_equal(kept.run.track.estimate.positions, without.run.track.estimate.positions)
        assert kept.level == RENDERED or kept.run.track.landmarks[-1] > 0  # tracks of three frames are none yet
