# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam check` prints a report that fits a terminal, writes it for programs, and tells by its exit code."""

import contextlib
import dataclasses
import io
import json
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import field
from pathlib import Path

import pytest
from faulty import FAULTS
from remembered import remembered_looks, remembered_sift

from uav_vslam.cli import check
from uav_vslam.cli.main import main
from uav_vslam.datasets.cdr import RawMessage
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.recordings.foreign import renamed, rewritten, without

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def _remembered() -> Iterator[None]:
    """All check the same images."""
    with remembered_sift(), remembered_looks():
        yield


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("check") / "flight"
    record(dataclasses.replace(SCENARIOS["kagaru"], frames=16, scale=0.15, seed=3), path)
    return path


@dataclasses.dataclass
class Progress:
    """What is shown in place of a bar: totals of the bars, and steps taken."""

    totals: list[int] = field(default_factory=list)
    steps: int = 0

    @contextlib.contextmanager
    def bar(self, _: str, total: int) -> Iterator[Callable[[], None]]:
        self.totals.append(total)
        yield self._advance

    def _advance(self) -> None:
        self.steps += 1


def checked(*arguments: str | Path) -> tuple[int, str, Progress]:
    """Run the command and return exit code, what it printed, and its progress."""
    progress, printed = Progress(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(check, "progress_bar", progress.bar)
        code = main(["check", *map(str, arguments)])
    return code, printed.getvalue(), progress


@pytest.fixture(scope="module")
def sound(flight: Path) -> tuple[int, str, Progress]:
    """The check of both vehicles as they are."""
    return checked(flight)


def test_a_sound_recording_of_two_vehicles_can_run(sound: tuple[int, str, Progress]) -> None:
    code, said, _ = sound
    assert code == 0
    for vehicle in ("uav1", "uav2"):
        assert f"{vehicle}: the graph can run: no errors, no warnings" in said
    assert max(map(len, said.splitlines())) <= 100


def test_what_can_not_run_is_told_by_text_file_and_exit_code(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = [one for name in ("no start state", "IMU in g", "stereo stamps 3 ms apart") for one in FAULTS[name][0]()]
    bag, out = rewritten(flight, tmp_path / "bag", *changes), tmp_path / "check.json"
    assert main(["check", str(bag), "--json", str(out)]) == 1
    said = capsys.readouterr().out
    assert "uav1: the graph can't run: 2 errors, 1 warning" in said
    assert "uav2: the graph can run" in said
    assert max(map(len, said.splitlines())) <= 100
    first, second = json.loads(out.read_text())["vehicles"]
    assert (first["vehicle"], first["usable"], first["errors"], first["warnings"]) == ("uav1", False, 2, 1)
    assert second["usable"]
    wrong = [finding["subject"] for finding in first["findings"] if finding["severity"] == "error"]
    assert wrong == ["IMU gravity size", "start state"]
    assert all(finding["remedy"] for finding in first["findings"] if finding["severity"] != "ok")


def test_a_vehicle_that_was_not_recorded_is_refused(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(flight), "--vehicles", "nobody"]) == 2
    assert "--vehicles nobody: not recorded; the bag holds uav1, uav2" in capsys.readouterr().err


def test_the_block_to_paste_has_the_start_that_the_report_advises(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = rewritten(flight, tmp_path / "bag", *FAULTS["no start state"][0]())
    assert main(["check", str(bag), "--vehicles", "uav1"]) == 1
    _, _, block = capsys.readouterr().out.partition("To put into a configuration")
    config = tmp_path / "mine.yaml"
    config.write_text("\n".join(line[4:] for line in block.splitlines() if line.startswith("    ")))
    assert main(["check", str(bag), "--vehicles", "uav1", "--config", str(config)]) == 0


def test_the_block_of_a_vehicle_with_another_name_finds_its_start(flight: Path, tmp_path: Path) -> None:
    """Its images and IMU are named from the root, its start state is in its namespace."""

    def of_a_drone(raw: RawMessage) -> RawMessage | None:
        if raw.topic.startswith("/uav2/"):
            return None
        topic = f"/drone{raw.topic.removeprefix('/uav1')}" if raw.topic.startswith("/uav1/") else raw.topic
        topic = topic.replace("/drone/left/", "/cam0/").replace("/drone/right/", "/cam1/")
        return dataclasses.replace(raw, topic=topic)

    bag = rewritten(flight, tmp_path / "bag", of_a_drone)
    base = ["--set", "input.frames.base=uav1/base_link"]  # the frames keep their names
    code, printed, _ = checked(bag, *base)
    words, _, block = printed.partition("To put into a configuration")[2].partition("\n")
    assert (code, words) == (1, " (--config FILE --vehicles drone):")
    config = tmp_path / "mine.yaml"
    config.write_text("\n".join(line[4:] for line in block.splitlines() if line.startswith("    ")))
    as_advised = [*base, "--config", str(config), "--vehicles", "drone"]
    assert checked(bag, *as_advised)[0] == 0
    options = ["--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path / "out")]
    assert main(["run", str(bag), *as_advised, *options]) == 0


def test_vehicles_with_other_topics_are_all_judged_and_one_block_serves_all(flight: Path, tmp_path: Path) -> None:
    def as_a_driver(raw: RawMessage) -> RawMessage:
        topic = re.sub("^/uav([12])/left/", r"/drone\1/camera/infra1/", raw.topic)
        topic = re.sub("^/uav([12])/right/", r"/drone\1/camera/infra2/", topic)
        topic = re.sub("^/uav([12])/imu/data_raw", r"/drone\1/camera/imu", topic)
        return dataclasses.replace(raw, topic=topic)

    own_names = [f"/uav{k}/{name}" for k in (1, 2) for name in ("initial_state", "ground_truth/odometry")]
    bag = rewritten(flight, tmp_path / "bag", without("/tf_static", *own_names), as_a_driver)
    code, printed, _ = checked(bag)
    parts = printed.split("To put into a configuration (--config FILE):\n\n")[1:]
    one, other = (textwrap.dedent(part.partition("\n\n")[0].strip("\n")) for part in parts)
    assert (code, one) == (1, other)
    config = tmp_path / "mine.yaml"
    config.write_text(one)
    again = checked(bag, "--config", str(config))[1]
    assert "topic names" not in again
    assert [name for name in ("drone1: ", "drone2: ") if name in again] == ["drone1: ", "drone2: "]


def test_the_progress_ends_at_its_total(sound: tuple[int, str, Progress], flight: Path, tmp_path: Path) -> None:
    foreign = rewritten(flight, tmp_path / "bag", renamed)
    for _, _, progress in (sound, checked(foreign, "--vehicles", "uav1")):
        assert progress.totals == [progress.steps]
        assert progress.steps


def test_settings_count(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(flight), "--vehicles", "uav1", "--set", "start.method=static"]) == 1
    assert "the vehicle moves" in capsys.readouterr().out


def test_a_fleet_file_names_recordings_and_vehicles(flight: Path, tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"vehicles: {{uav2: {{}}}}\nreplay: {{bags: [{flight}]}}\n")
    code, _, progress = checked(fleet, "--json", tmp_path / "check.json")
    assert code == 0
    assert progress.totals == [progress.steps]  # of one vehicle out of two
    (only,) = json.loads((tmp_path / "check.json").read_text())["vehicles"]
    assert only["vehicle"] == "uav2"
    assert main(["check", str(fleet), "--config", "kagaru"]) == 2


def test_a_json_file_that_can_not_be_written_is_refused_before_the_check(flight: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as leaving:
        main(["check", str(flight), "--json", str(tmp_path / "nowhere" / "check.json")])
    assert leaving.value.code == 2


@pytest.mark.parametrize(("name", "said"), [("nowhere", "does not exist"), ("notes.txt", "is not a bag")])
def test_what_is_no_bag_is_wrong_input(
    name: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    assert main(["check", str(tmp_path / name)]) == 2
    assert said in capsys.readouterr().err
