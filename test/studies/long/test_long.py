# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.config import RETENTION_POLICIES
from uav_vslam.studies.engine.own_only import run_trials
from uav_vslam.studies.long.compute import POLICIES, SPAN, long_rows, long_series, long_trial


def test_all_policies_fly_the_long_scenario_by_default():
    trial = long_trial(POLICIES)
    assert [c.track.keywords["config"].backend.retention for c in trial.candidates] == list(RETENTION_POLICIES)
    assert (trial.scenario.frames, trial.scenario.pattern) == (1000, "lawnmower")


def test_late_frames_are_compared_with_early_ones_of_the_same_run(make_run, monkeypatch):
    monkeypatch.setattr("uav_vslam.studies.long.compute.SPAN", 10)  # these runs have 40 frames
    slow, fast = (np.r_[np.full(10, 99.0), np.full(10, ms), np.full(10, 99.0), np.full(10, 1.5 * ms)] for ms in (8, 2))
    sizes = {"landmarks": np.full(40, 50), "resident_mb": np.r_[np.full(5, 80.0), np.full(6, 90.0), np.full(29, 93.0)]}
    (row,) = long_rows([make_run("grid", frame_ms=slow, **sizes), make_run("grid", frame_ms=fast, **sizes)])
    assert (row["ms_per_frame_early"], row["ms_per_frame_late"], row["late_to_early"]) == (5.0, 7.5, 1.5)
    assert (row["landmarks_mean"], row["landmarks_max"], row["growth_mb"]) == (50.0, 50, 3.0)


def test_a_flight_too_short_to_compare_has_no_ratio(make_run):
    assert len(make_run().truth) < 3 * SPAN
    assert long_rows([make_run("grid")])[0]["late_to_early"] is None


def test_alignment_forgives_the_yaw_of_the_start(make_run):
    (row,) = long_rows([make_run("grid", end=(0.0, 1.0, 0.0))])  # 1 m to the side after 78 m
    assert row["ate_rms_m"] > 0.5
    assert row["ate_yaw_aligned_rms_m"] < 0.01


def test_curves_are_pooled_over_the_finished_runs_of_each_variant():
    runs = run_trials([long_trial({"all": {}, "few": {"backend.max_in_view": 20}}, frames=8)], [1, 2], workers=1)
    curves = long_series(runs)
    assert [curve["method"] for curve in curves] == ["all", "few"]
    ends = [np.linalg.norm(run.track.estimate.positions[-1] - run.truth.positions[-1]) for run in runs[::2]]
    assert curves[0]["error_m"][-1] == pytest.approx(np.sqrt(np.mean(np.square(ends))), abs=1e-3)
    assert curves[0]["distance_m"][-1] == pytest.approx(7 * 20 / 7.14, rel=0.1)  # at 20 m/s
    assert max(curves[1]["landmarks"]) < 30 < max(curves[0]["landmarks"])
    assert {len(curve[key]) for curve in curves for key in ("distance_m", "error_m", "ms_per_frame", "landmarks")} == {
        8
    }
