# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from uav_vslam.config import FILTERS, STATE_MODELS
from uav_vslam.evaluation.study import TABLE
from uav_vslam.simulation.landmarks import PER_FRAME
from uav_vslam.studies.engine.own_only import INS, run_trials
from uav_vslam.studies.filters.compute import (
    BATCH,
    BESIDE,
    RER,
    SCALES,
    candidate,
    consistency_rows,
    consistency_trial,
    noise_rows,
    noise_trials,
    optimum,
)


def settings(found):
    return found.track.keywords["config"].backend


def lines_of(rows, method):
    return {row["condition"]: row for row in rows if row[TABLE] == RER["SIFT"] and row["method"] == method}


def test_every_filter_and_every_model_is_compared():
    found = [settings(c) for c in consistency_trial().candidates if c.name not in {INS, BATCH}]
    assert {backend.filter for backend in found} == set(FILTERS)
    assert {backend.model for backend in found} == set(STATE_MODELS)
    assert all((backend.depth_sigma_ratio == 0.0) == (backend.model == "euler9") for backend in found)


def test_the_noise_scales_are_the_thesiss():
    trials = noise_trials()
    assert [trial.condition for trial in trials] == ["w1", "w2", "w3", "w4"]
    for trial, rate_deg, accel in zip(trials, (1, 2, 2, 4), (1.8, 3.6, 5.6, 11.2), strict=True):
        imu, step_s = trial.scenario.imu_config, 0.14
        assert imu.gyro_noise / math.sqrt(step_s) == pytest.approx(math.radians(rate_deg))  # over one time step
        assert imu.accel_noise / math.sqrt(step_s) == pytest.approx(accel)
        assert trial.scenario.frames == 100
        assert 1 / trial.scenario.frame_rate_hz == pytest.approx(step_s, rel=1e-3)
        assert trial.noise.sigma_px**2 == pytest.approx(10.0)
        assert all(settings(c).sigma_px == trial.noise.sigma_px for c in trial.candidates if c.name != INS)


def test_surf_differs_from_sift_as_measured():
    sift, surf = (noise_trials(extractor)[0] for extractor in ("SIFT", "SURF"))
    assert sift.noise.wrong_share == 0.0
    assert sift.per_frame == PER_FRAME
    assert surf.noise.sigma_px / sift.noise.sigma_px == pytest.approx(0.273 / 0.089)
    assert surf.noise.wrong_share == pytest.approx(0.067 - 0.011)
    assert surf.per_frame / sift.per_frame == pytest.approx(209 / 571)
    assert all(settings(c).sigma_px == surf.noise.sigma_px for c in surf.candidates if c.name != INS)


def test_each_extractors_table_stands_under_its_own_heading(make_run):
    runs = [make_run("ri15 eif", condition=scale) for scale in SCALES]
    assert {row[TABLE] for row in noise_rows(runs, "SURF")} == {RER["SURF"], BESIDE["SURF"]}
    assert not {RER["SURF"], BESIDE["SURF"]} & {row[TABLE] for row in noise_rows(runs)}


def test_end_errors_stand_beside_that_of_the_batch_optimum(make_run):
    runs = [make_run("ri15 eif", end=(3.0, 0.0, 0.0)), make_run(BATCH, end=(2.0, 0.0, 0.0))]
    assert [row["end_ratio_to_batch"] for row in consistency_rows(runs)] == pytest.approx([1.5, 1.0])
    assert consistency_rows(runs[:1])[0]["end_ratio_to_batch"] is None


def test_the_table_shows_the_best_the_median_and_the_worst_run_and_their_mean(make_run):
    ends = (5.0, 1.0, 2.0, 8.0)  # of 10 m
    runs = [make_run("ri15 eif", end=(end,) * 3, condition=scale) for scale in SCALES for end in ends]
    lines = lines_of(noise_rows(runs), "ri15 eif")
    for scale in SCALES:
        assert [lines[run][f"rer_{scale}"] for run in ("R1", "R2", "R3")] == pytest.approx([0.1, 0.2, 0.8])
        assert lines["Ave"][f"rer_{scale}"] == pytest.approx(1.1 / 3)
        assert lines["all"][f"rer_{scale}"] == pytest.approx(0.4)


def test_a_filter_that_never_came_to_an_end_keeps_its_place_in_the_table(make_run):
    rows = noise_rows([make_run("euler9 thesis_uhf", condition=scale, frames=3) for scale in SCALES])
    assert {run: line["rer_w1"] for run, line in lines_of(rows, "euler9 thesis_uhf").items()} == dict.fromkeys(
        ("R1", "R2", "R3", "Ave", "all")
    )
    assert [(row["condition"], row["failures"]) for row in rows if row[TABLE] == BESIDE["SIFT"]] == [
        (s, 1) for s in SCALES
    ]


def test_a_filter_comes_near_the_batch_optimum_and_far_from_the_ins():
    trial = consistency_trial(frames=30, vehicles=1)
    few = [c for c in trial.candidates if c.name in {INS, "ri15 eif", "ri15 ekf", BATCH}]
    runs = run_trials([type(trial)(trial.condition, trial.scenario, tuple(few))], [1], workers=1)
    ins, eif, ekf, batch = (run.track.estimate.positions for run in runs)
    truth = runs[0].truth.positions
    np.testing.assert_allclose(ekf, eif, atol=1e-3)
    assert np.linalg.norm(eif[-1] - batch[-1]) < 0.5 * np.linalg.norm(ins[-1] - truth[-1])


def test_what_gtsam_raises_is_a_failure_and_no_end_of_the_study(monkeypatch, make_run):
    def give_up(*_):
        raise RuntimeError("\nIndeterminate linear system detected\nnear b22")

    monkeypatch.setattr("uav_vslam.studies.filters.compute.gtsam_batch", give_up)
    flight = type("Flight", (), {"vehicle": None, "landmarks": None, "noise": consistency_trial().noise})()
    track = optimum(flight)
    assert track.failure == "Indeterminate linear system detected"
    assert len(track.estimate) == 0


def test_a_candidate_takes_other_settings():
    assert settings(candidate("ri15", "uhf", gamma=7.0)).gamma == 7.0
