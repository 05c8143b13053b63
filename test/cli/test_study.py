# SPDX-License-Identifier: Apache-2.0
"""Each study runs from the command line and leaves its tables, notes and pictures."""

import contextlib
import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser, browser

from uav_vslam.cli import main as command
from uav_vslam.cli.study import seeds_of
from uav_vslam.evaluation.output import LATEST
from uav_vslam.studies.registry import STUDIES

SMALL = {
    "frames": ["--seeds", "1", "--frames", "12"],
    "map_reuse": ["--seeds", "1", "--rendered-seeds", "0", "--frames", "12"],
    "models": ["--seeds", "1", "--frames", "9"],
    "flights": ["--seeds", "1", "--frames", "4", "--vehicles", "1", "--rate", "20", "--imu", "consumer"],
    "fusion": ["--parts", "fleets", "--seeds", "1", "--frames", "9"],
    "thesis": ["--seeds", "1", "--frames", "9"],
    "filters": ["--seeds", "1", "--vehicles", "1", "--frames", "3", "--runs", "1", "--steps", "2"],
    "long": ["--seeds", "1", "--frames", "12"],
    "outliers": ["--seeds", "1", "--vehicles", "1", "--frames", "5"],
    "revisit": ["--seeds", "1", "--rendered-seeds", "1", "--frames", "3"],
    "association": ["--seeds", "1", "--frames", "6", "--methods", "gated", "hgtm"],
    "recordings": ["--seeds", "1", "--frames", "3"],
    "perturbed": ["--seeds", "1", "--rendered-seeds", "0", "--frames", "2"],
    "surface": ["--seeds", "1", "--frames", "5", "--bare"],
    "orthomosaic": ["--seeds", "1", "--frames", "12", "--m-per-px", "0.3"],
}
LARGEST_PAGE_BYTES = 8_000_000
PICTURES = {
    "frames": set(),
    "models": {"nees.png"},
    "flights": {"nees.png"},
    "fusion": {"fleets.png", "three_in_a_row.png"},
    "thesis": {f"{px}_px{what}.png" for px in (6, 10) for what in ("", "_trajectory", "_errors", "_covariance")},
    "filters": {"consistency.png", "noise_scales_sift.png", "noise_scales_surf.png"},
    "long": {"long.png"},
    "outliers": {"outliers.png"},
    "revisit": {"revisit.png"},
    "association": {"association.png", "matching.png"},
    "recordings": set(),
    "surface": set(),
    "map_reuse": set(),
    "orthomosaic": {"orthomosaic.png"},
    "perturbed": {"perturbed.png", "nees_landmark_level.png"},
}


@pytest.fixture(scope="module", params=SMALL)
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, str]:
    """Each study, run once: its name, the folder of its results, and what it printed."""
    study, root, printed = str(request.param), tmp_path_factory.mktemp("study"), io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert command.main(["study", study, *SMALL[study], "--workers", "1", "--results", str(root)]) == 0
    return study, (root / LATEST).resolve(), printed.getvalue()


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser")) as running:
        yield running


@pytest.mark.slow
def test_a_study_leaves_its_tables_pictures_and_page(done: tuple[str, Path, str]) -> None:
    study, folder, printed = done
    assert {path.name for path in folder.iterdir()} == {"study.json", "study.md", "report.html"} | PICTURES[study]
    assert json.loads((folder / "study.json").read_text())["study"] == f"study_{study}"
    assert (folder / "study.md").read_text() in printed


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_every_studys_page_opens_with_all_its_rows_and_pictures(done: tuple[str, Path, str], chromium: Browser) -> None:
    _, folder, _ = done
    chromium.open(folder / "report.html", width=390)
    assert chromium.complaints == []
    assert chromium.evaluate("document.documentElement.dataset.errors") == "0"
    assert chromium.evaluate("document.documentElement.scrollWidth") == 390
    rows = len(json.loads((folder / "study.json").read_text())["rows"])
    assert chromium.evaluate("document.querySelectorAll('tbody tr').length") == rows
    assert chromium.evaluate("document.images.length") == len(list(folder.glob("*.png")))
    assert (folder / "report.html").stat().st_size < LARGEST_PAGE_BYTES


@pytest.mark.parametrize("study", ["long", "outliers"])
def test_variants_take_the_place_of_the_studys_own_settings(study: str, tmp_path: Path) -> None:
    variants = ["backend.robust=false,backend.max_in_view=30", "backend.gate_probability=0.95"]
    options = [word for variant in variants for word in ("--variant", variant)]
    command.main(["study", study, *SMALL[study], *options, "--workers", "1", "--results", str(tmp_path)])
    rows = json.loads((tmp_path / LATEST / "study.json").read_text())["rows"]
    assert list(dict.fromkeys(row["method"] for row in rows)) == variants


@pytest.mark.parametrize(
    ("variant", "message"),
    [("backend.robust", "must have the form KEY=VALUE"), ("backend.robsut=true", "did you mean backend.robust?")],
)
def test_a_wrong_variant_is_one_line_and_exit_code_2(
    variant: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["study", "long", "--variant", variant]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("option", "message"), [("--pattern", "pattern 'wrong' is not known"), ("--imu", "imu grade 'wrong' is not known")]
)
def test_a_flight_that_can_not_be_simulated_is_refused_in_one_line(
    option: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["study", "flights", option, "wrong"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("surface --cell 0", "'0' is not a number above 0"),
        ("surface --cell 1e9", "'1e9' is not a number above 0 and at most 100 [m]"),
        ("orthomosaic --m-per-px -1", "'-1' is not a number above 0"),
        ("filters --altitude -5", "'-5' is not a number above 0"),
        ("filters --speed nan", "'nan' is not a number above 0"),
        ("live --rate 0", "'0' is not a number above 0"),
        ("live --mode telepathy", "invalid choice: 'telepathy'"),
        ("perturbed --rendered-seeds=-1", "'-1' is not a whole number of at least 0"),
        ("revisit --frames 1", "'1' is not a whole number of at least 2"),
        ("filters --runs 0", "'0' is not a whole number of at least 1"),
        ("features --width 1.5", "'1.5' is not a whole number of at least 64"),
    ],
)
def test_a_wrong_value_of_a_study_is_refused_before_it_starts(
    arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(["study", *arguments.split()])
    assert leaving.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_explains_itself_with_examples(study: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(["study", study, "--help"])
    assert leaving.value.code == 0
    text = capsys.readouterr().out
    assert f"\n  uav-vslam study {study}" in text
    assert "--seeds" in text


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_draws_the_seeds_that_it_is_given(study: str) -> None:
    arguments = ["study", study, *["folder"] * (study in {"euroc", "split"}), "--seeds", "3", "--first-seed", "1001"]
    assert seeds_of(command.build_parser(arguments).parse_args(arguments)) == [1001, 1002, 1003]


def test_a_study_that_is_not_known_is_wrong_input(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        command.main(["study", "clouds"])
    assert leaving.value.code == 2
    assert "filters" in capsys.readouterr().err


@pytest.mark.slow
def test_a_study_of_flights_needs_a_seed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command.main(["study", "recordings", "--seeds", "0"])
    assert "--seeds: '0' is not a count of at least 1" in capsys.readouterr().err
