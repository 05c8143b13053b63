# SPDX-License-Identifier: Apache-2.0
"""The thesis study's notes are about its own flights and figures."""

import argparse

import pytest

from uav_vslam.studies.engine.columns import COLUMNS
from uav_vslam.studies.engine.study import Findings
from uav_vslam.studies.thesis import STUDY

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found() -> Findings:
    """The study's rows and notes; `test_study` publishes and draws them."""
    return STUDY.run(argparse.Namespace(frames=12, workers=1), [1], lambda _: lambda *_: None)


def test_the_notes_give_the_pixel_noise_of_its_own_flights(found: Findings) -> None:
    assert {row["condition"] for row in found.rows} == {"6 px", "10 px"}
    assert "6 and 10 px" in found.notes["Flights"]
    text = " ".join(found.notes.values())
    assert " 1 px" not in text
    assert "ADIS16480" not in text


def test_no_note_explains_a_figure_that_the_study_does_not_have(found: Findings) -> None:
    columns = {key for row in found.rows for key in row}
    assert {subject for subject in found.notes if subject in COLUMNS} <= columns
