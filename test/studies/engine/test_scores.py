# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest

from uav_vslam.studies.engine.own_only import INS
from uav_vslam.studies.engine.scores import breakdowns, failures, is_finished, nees_figures, pooled, relative_error_rate


def test_errors_and_nees_are_pooled_over_the_runs(make_run):
    row = pooled([make_run(end=(3.0, 0.0, 0.0)), make_run(end=(0.0, -4.0, 0.0))])
    assert row["end_rms_m"] == pytest.approx(np.sqrt(12.5))
    assert row["nees_position_end"] == pytest.approx((9.0 + 16.0) / 2 / 3)
    assert (row["runs"], row["failures"]) == (2, 0)


def test_consistency_is_judged_over_seeds_over_time_and_by_run():
    settled, late = np.full(60, 1.0), np.r_[np.full(20, 99.0), np.full(30, 1.0), np.full(10, 16.0)]
    found = nees_figures([(1, settled), (1, settled), (2, settled), (3, late)])
    assert found["nees_position"] == pytest.approx((3 * 1.0 + 4.75) / 4)  # the first 20 keyframes do not count
    assert found["nees_position_worst_quarter"] == pytest.approx((3 * 1.0 + 16.0) / 4)
    assert found["nees_position_outside"] == 0.25  # 4.75 is beyond 3.1, which one NEES exceeds once in 40 times
    assert found["nees_position_low"] == pytest.approx(1.0)
    assert found["nees_position_high"] == pytest.approx(4.75)


def test_a_cautious_run_is_outside_of_the_band_as_well():
    assert nees_figures([(1, np.full(40, 0.05)), (2, np.full(40, 0.1))])["nees_position_outside"] == 0.5


def test_flights_that_are_too_short_to_judge_have_no_consistency():
    assert nees_figures([(1, np.ones(21))]) == {"nees_position": None}


def test_the_time_is_the_median_of_all_frames(make_run):
    runs = [make_run(frame_ms=np.array([1.0, 2.0, 90.0])), make_run(frame_ms=np.array([3.0, 4.0]))]
    assert pooled(runs)["ms_per_frame"] == 3.0
    assert pooled([make_run()])["ms_per_frame"] is None


def test_a_run_that_stopped_early_or_lost_its_numbers_is_not_finished(make_run):
    assert is_finished(make_run())
    assert not is_finished(make_run(frames=39))
    assert not is_finished(make_run(failure="FilterDivergence: at 3 s"))
    assert not is_finished(make_run(end=(np.nan, 0.0, 0.0)))


def test_what_was_not_finished_is_counted_and_not_pooled(make_run):
    row = pooled([make_run(end=(3.0, 0.0, 0.0)), make_run(end=(50.0, 0.0, 0.0), frames=20)])
    assert row["end_rms_m"] == pytest.approx(3.0)
    assert row["failures"] == 1
    assert pooled([make_run(frames=20)])["end_rms_m"] is None


def test_a_run_fails_when_it_ends_beyond_what_the_ins_does_on_average(make_run):
    lucky_ins, usual_ins = (0.1, 0.0, 0.0), (10.0, 0.0, 0.0)  # together 7.07 m
    runs = [make_run(end=(7.0, 0.0, 0.0), ins=lucky_ins), make_run(end=(7.2, 0.0, 0.0), ins=usual_ins)]
    assert failures(runs) == 1


def test_a_filter_that_began_anew_has_failed_and_its_errors_are_not_its_own(make_run):
    row = pooled([make_run(end=(1e15, 0.0, 0.0), restarts=3, failure="indefinite"), make_run()])
    assert (row["failures"], row["restarts"]) == (1, 3)
    assert row["end_rms_m"] == pytest.approx(1.0)


def test_the_first_reason_of_each_breakdown_is_told(make_run):
    runs = [make_run(), make_run("uhf", seed=2, failure="indefinite"), make_run("uhf", seed=3, failure="lost")]
    assert breakdowns(runs) == {"Breakdowns": "uhf (first in w1, seed 2): indefinite"}
    assert breakdowns(runs[:1]) == {}


def test_the_ins_can_not_fail_by_its_own_measure(make_run):
    runs = [make_run(INS, end=end, ins=end) for end in ((1.0, 0.0, 0.0), (9.0, 0.0, 0.0))]
    assert failures(runs) == 0


def test_the_relative_error_rate_is_the_mean_over_the_axes(make_run):
    assert relative_error_rate([make_run(end=(1.0, 2.0, 6.0), ins=(10.0, 10.0, 20.0))]) == pytest.approx(0.6 / 3)


def test_the_relative_error_rate_sums_over_all_steps_of_a_flight(make_run):
    run = make_run(end=(0.0, 0.0, 0.0), ins=(8.0, 8.0, 8.0))  # the INS is off by 4 m on average
    bumped = run.track.estimate.positions.copy()
    bumped[10:15] += 2.0  # in a quarter of the steps, half of them to each side; at the last one SLAM is exact
    bumped[15:20] -= 2.0
    estimate = dataclasses.replace(run.track.estimate, positions=bumped)
    run = dataclasses.replace(run, track=dataclasses.replace(run.track, estimate=estimate))
    assert relative_error_rate([run]) == pytest.approx(0.25 * 2.0 / 4.0)


def test_the_rate_of_many_runs_sums_before_it_divides(make_run):
    runs = [make_run(end=(1.0, 1.0, 1.0), ins=(2.0, 2.0, 2.0)), make_run(end=(1.0, 1.0, 1.0), ins=(8.0, 8.0, 8.0))]
    assert relative_error_rate(runs) == pytest.approx(0.2)


def test_the_sign_of_an_error_does_not_matter_to_the_rate(make_run):
    assert relative_error_rate([make_run(end=(1.0, -1.0, 1.0))]) == pytest.approx(0.1)


def test_runs_without_an_end_have_no_rate(make_run):
    assert relative_error_rate([make_run(frames=20)]) is None
    assert relative_error_rate([make_run(frames=20), make_run()]) == pytest.approx(1.0 / 30)
