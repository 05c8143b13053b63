# SPDX-License-Identifier: Apache-2.0
"""The study's flights start in the map, and its way of not declaring the map shows."""

import numpy as np
import pytest

from uav_vslam.studies.engine.study import Findings
from uav_vslam.studies.map_reuse.compute import ALONE, NOTES, SETTINGS, WITH_MAP, Flight, Job, run_seed, study_rows

pytestmark = pytest.mark.slow

FRAMES = 36


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    """Return both vehicles of one seed."""
    return run_seed(Job(seed=3, frames=FRAMES))


def test_both_vehicles_start_in_the_map_s_frame_under_every_setting(flights: list[Flight]) -> None:
    for flight in flights:
        assert flight.found_s is not None
        assert flight.start_error_m < 4.0
        assert set(flight.nees) == {ALONE, *(setting.name for setting in SETTINGS)}
        assert {len(errors) for errors in flight.errors_m.values()} == {len(flight.errors_m[ALONE])}


def test_what_is_not_declared_is_summed(flights: list[Flight]) -> None:
    """Without the declaration split_ci does what a plain sum does; with it, it stays as cautious as alone."""
    for flight in flights:
        summed, bare = flight.nees["together, plain sum"], flight.nees["together, split_ci, map not declared"]
        np.testing.assert_allclose(bare, summed)
        assert flight.nees[WITH_MAP][-1] < summed[-1]


def test_the_smallest_run_makes_rows_of_declared_columns() -> None:
    rows = study_rows([3], [], frames=12, workers=1)
    assert len(Findings(rows, NOTES).rows) == 2 + len(SETTINGS)
