# SPDX-License-Identifier: Apache-2.0
"""The study of starts: what it counts as settled and as warned."""

import math

import pytest

from uav_vslam.evaluation.study import TABLE
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.start import compute as in_flight
from uav_vslam.studies.start.compute import WRONGS, InFlight, _pooled, fly_in_flight, fly_wrong, study_rows


def test_a_flight_without_a_start_state_is_scored_in_its_own_frame() -> None:
    run = fly_in_flight(Scenario(frames=45, vehicles=1))
    assert run is not None
    assert run.velocity_error < 0.5
    assert run.settled_s <= 5.0
    assert run.end_error_m < 3.0  # 126 m flown from 70 m up: in any other frame it would be tens of metres
    assert run.nees_position < 5.0


def test_a_flight_that_ends_before_the_start_has_to_be_settled_has_no_nees() -> None:
    run = fly_in_flight(Scenario(frames=20, vehicles=1))
    assert run is not None
    assert math.isnan(run.nees_position)


def test_only_a_wrong_start_is_warned_of() -> None:
    assert not fly_wrong(("nothing", 1))
    assert fly_wrong(("velocity in all axes", 1))


def test_flights_that_never_settle_are_not_counted_as_settled() -> None:
    good = InFlight(0.1, 0.5, 1.0, 1.0, 2.0)
    row = _pooled([good, InFlight(0.3, 0.5, math.inf, 3.0, 2.0)], 3)
    assert (row["found"], row["runs"], row["settled"]) == (2, 3, 1)
    assert row["nees_position"] == 2.0
    assert row["settled_worst_s"] == "never"
    assert _pooled([good], 3)["settled_worst_s"] == 1.0
    assert _pooled([good, InFlight(0.3, 0.5, 1.0, math.nan, 2.0)], 3)["nees_position"] == 1.0  # one is too short
    assert _pooled([], 3)["nees_position"] is None


@pytest.mark.slow
def test_the_study_has_a_row_for_each_unit_and_each_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    two = {what: WRONGS[what] for what in ("nothing", "velocity up")}
    monkeypatch.setattr(in_flight, "WRONGS", two)
    jobs: list[None] = []
    rows = study_rows(["adis16480"], [2], frames=45, workers=1, on_job=lambda: jobs.append(None))
    assert [row["condition"] for row in rows if row[TABLE] == "no start state"] == ["adis16480"]
    assert [(row["condition"], row["warned"]) for row in rows[1:]] == [("nothing", 0), ("velocity up", 1)]
    assert len(jobs) == 1 + len(two)
