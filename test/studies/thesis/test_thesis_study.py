# SPDX-License-Identifier: Apache-2.0
"""The thesis study's notes are about its own flights and figures."""

import json

import pytest

from uav_vslam.cli import main as command
from uav_vslam.evaluation.output import LATEST
from uav_vslam.studies.engine.columns import COLUMNS


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("thesis")
    arguments = ["study", "thesis", "--seeds", "1", "--frames", "12", "--workers", "1", "--results", str(folder)]
    assert command.main(arguments) == 0
    return json.loads((folder / LATEST / "study.json").read_text(encoding="utf-8"))


def test_the_notes_give_the_pixel_noise_of_its_own_flights(study: dict) -> None:
    assert {row["condition"] for row in study["rows"]} == {"6 px", "10 px"}
    assert "6 and 10 px" in study["notes"]["Flights"]
    text = " ".join(study["notes"].values())
    assert " 1 px" not in text
    assert "ADIS16480" not in text


def test_no_note_explains_a_figure_that_the_study_does_not_have(study: dict) -> None:
    columns = {key for row in study["rows"] for key in row}
    assert {subject for subject in study["notes"] if subject in COLUMNS} <= columns
