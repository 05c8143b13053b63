# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam run` says which changed settings decide nothing, and what is wrong with readings that it uses."""

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from faulty import IMU, TRUTH, in_unit, later, never_turned, of_other_axes
from short_bag import before

from uav_vslam.cli.main import main
from uav_vslam.datasets.rosbag import topics_of
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.recordings.foreign import edited, rewritten, shifted
from uav_vslam.types import NS_PER_S

WARNING = "uav-vslam: warning: "
SAMPLE = Path(__file__).parents[2] / "bags" / "sample"
SAMPLE_FROM_NS = 1_283_212_800_000_000_000  # its first image


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=2, frames=4, scale=0.125, seed=3), path)
    return path


@pytest.mark.parametrize(("method", "count"), [("klt", 1), ("sift", 0)])
def test_association_with_klt_is_warned_about_once_for_all_vehicles(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, count: int
) -> None:
    changes = ["--set", "backend.association=hgtm", "--set", f"frontend.method={method}"]
    assert main(["run", str(flight), *changes, "--no-plots", "--workers", "1", "--results", str(tmp_path)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "backend.association" in line]
    assert len(lines) == count
    assert all(line.startswith(f"{WARNING}backend.association = hgtm decides almost nothing") for line in lines)


@pytest.mark.parametrize(("mode", "count"), [("wideband", 1), ("none", 0)])
def test_vehicles_that_can_not_share_a_frame_are_warned_about(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], mode: str, count: int
) -> None:
    """Their C-SLAM would be S-SLAM, without a word; so short a flight ends before a start is found."""
    changes = ["--set", "start.method=in_flight", "--mode", mode, "--no-plots", "--results", str(tmp_path)]
    assert main(["run", str(flight), *changes, "--workers", "1"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "map frame of their own" in line]
    assert [line.partition(" each")[0] for line in lines] == [f"{WARNING}uav1, uav2"] * count


@pytest.mark.parametrize(("mode", "count"), [("wideband", 1), ("none", 0)])
def test_vehicles_whose_clocks_are_an_hour_apart_are_warned_about(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], mode: str, count: int
) -> None:
    """Offline, packets are exchanged by stamps: their C-SLAM would be S-SLAM, without a word."""
    own = [topic for topic in topics_of([flight]) if topic.startswith("/uav2/")]
    bag = rewritten(flight, tmp_path / "apart", *(later(topic, 3600 * NS_PER_S) for topic in own))
    arguments = ["--mode", mode, "--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path / "out")]
    assert main(["run", str(bag), *arguments, "--workers", "1"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "clocks differ" in line]
    assert [line.partition(" s after the end of uav1")[0] for line in lines] == [f"{WARNING}uav2 begins 3600"] * count


def test_imu_readings_stamped_in_bursts_are_warned_about_once(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their motion counts at the wrong time, and nothing else in the results tells."""
    number = itertools.count()

    def as_they_arrive(reading: Any) -> Any:
        place = next(number) % 20  # in its batch
        return shifted(reading, place * (50_000 - 5_000_000))

    bag = rewritten(flight, tmp_path / "bursts", edited(IMU, as_they_arrive))
    arguments = ["--vehicles", "uav1", "--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path / "out")]
    assert main(["run", str(bag), *arguments]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "bursts" in line]
    assert line.startswith(f"{WARNING}uav1: IMU readings are stamped in bursts, 20000 Hz within")


def nowhere(pose: Any) -> Any:
    q = pose.pose.pose.orientation
    q.w = q.x = q.y = q.z = 0.0
    return pose


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            nowhere,
            "poses of the ground truth are not finite, unreadable or lack a rotation, and are left out; none remains",
        ),
        (
            lambda pose: shifted(pose, -NS_PER_S * 60),
            "ground truth is from -60.00 to -59.58 s after the first frame",
        ),
    ],
)
def test_ground_truth_with_which_nothing_is_compared_is_warned_about(
    change: Callable[[Any], Any], said: str, flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tables would lack errors without a word; the flight itself can be run."""
    bag = rewritten(flight, tmp_path / "bag", edited("/uav1/ground_truth/odometry", change))
    arguments = ["--vehicles", "uav1", "--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path / "out")]
    assert main(["run", str(bag), *arguments]) == 0
    printed = capsys.readouterr()
    assert said in printed.err
    assert "uav1: 0 m" not in printed.out
    assert main(["check", str(bag), "--vehicles", "uav1"]) == 0


@pytest.mark.parametrize(
    ("unit_m", "said"), [(1e-3, "1e+03 times what the estimate does, as if it were in millimetres"), (1.0, "")]
)
def test_ground_truth_in_another_unit_is_warned_about(
    unit_m: float, said: str, flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ATE was kilometres, without a word."""
    bag = rewritten(flight, tmp_path / "bag", in_unit(unit_m))
    arguments = ["--vehicles", "uav1", "--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path / "out")]
    assert main(["run", str(bag), *arguments]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "extends over" in line]
    assert len(lines) == bool(said)
    assert all(said in line for line in lines)


@pytest.mark.parametrize("change", [of_other_axes, lambda message: message])
def test_ground_truth_of_other_axes_is_warned_about(
    change: Callable[[Any], Any], flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a motion capture gives it: NEES was half a million, without a word."""
    bag = rewritten(flight, tmp_path / "bag", edited("/uav1/ground_truth/odometry", change))
    arguments = ["--vehicles", "uav1", "--no-plots", "--no-maps", "--no-smoothing", "--results", str(tmp_path / "out")]
    assert main(["run", str(bag), *arguments]) == 0
    said = "the ground truth is turned by 132 deg against the body, alike in all poses"
    assert (said in capsys.readouterr().err) == (change is of_other_axes)


@pytest.mark.slow
def test_ground_truth_that_never_turns_is_warned_about_and_attitude_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its attitude counted as an error of the estimate, with a NEES of 634."""
    begin = before(SAMPLE_FROM_NS + 7 * NS_PER_S, SAMPLE, tmp_path / "begin")
    bag = rewritten(begin, tmp_path / "bag", edited(TRUTH, never_turned))
    arguments = ["--config", "sample", "--no-plots", "--no-maps", "--no-smoothing", "--workers", "1"]
    arguments += ["--mode", "none", "--set", "backend.max_in_view=30"]
    assert main(["run", str(bag), *arguments, "--results", str(tmp_path / "out")]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "never changes" in line]
    assert [line.startswith(f"{WARNING}uav1: the orientation of the ground truth") for line in lines] == [True]
    vehicles = json.loads((tmp_path / "out" / "latest" / "summary.json").read_text())["vehicles"]
    errors, true = (vehicles[name]["s_slam"] for name in ("uav1", "uav2"))
    assert errors["ate_m"] is not None
    for key in ("rpe_5s_m", "rpe_5s_deg", "rpe_14m_attitude_mrad", "nees_rotation"):
        assert errors[key] is None
        assert true[key] is not None


@pytest.mark.slow
@pytest.mark.parametrize("late_ns", [0, 40_000_000])
def test_a_flight_that_is_mostly_dead_reckoning_is_warned_about(
    late_ns: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Here for the IMU's clock, too far off to be found; the innovations of the few frames left look conservative."""
    begin = before(SAMPLE_FROM_NS + 3 * NS_PER_S, SAMPLE, tmp_path / "begin")
    bag = rewritten(begin, tmp_path / "late", later(IMU, late_ns))
    arguments = ["--vehicles", "uav1", "--config", "sample", "--no-plots", "--no-maps", "--no-smoothing"]
    assert main(["run", str(bag), *arguments, "--results", str(tmp_path / "out")]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "none where the estimate expects it" in line]
    assert [line.startswith(f"{WARNING}uav1: ") and "of 22 frames had features" in line for line in lines] == [True] * (
        late_ns > 0
    )
