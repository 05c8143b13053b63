# SPDX-License-Identifier: Apache-2.0
"""The simulate verb records what its arguments say."""

import argparse
import re
from pathlib import Path

import pytest

from uav_vslam.cli import simulate
from uav_vslam.config import IMU_GRADES
from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.errors import ConfigError
from uav_vslam.simulation.flight_path import PATTERNS
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.types import StereoFrame


def parse(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    simulate.add_arguments(parser)
    return parser.parse_args(arguments)


def test_arguments_reach_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "flight"
    args = parse(
        str(out), "--frames", "3", "--vehicles", "1", "--scale", "0.125", "--compressed", "jpeg", "--seed", "9"
    )
    assert simulate.run(args) == 0
    assert vehicles([out]) == ["uav1"]
    flight = open_flight(out, "uav1")
    assert (flight.frame_count, flight.image_size) == (3, (160, 120))
    assert flight.left_topic.endswith("compressed")
    assert f"{out}: 1 vehicles, 3 image pairs each" in capsys.readouterr().out


@pytest.mark.parametrize("coding", [[], ["--compressed", "png"]])
def test_a_quality_without_jpeg_is_refused(coding: list[str], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="give --compressed jpeg"):
        simulate.run(parse(str(tmp_path / "flight"), "--quality", "50", *coding))
    assert simulate.coding_from(parse("x", "--compressed", "jpeg", "--quality", "50")).quality == 50
    assert simulate.coding_from(parse("x", "--compressed", "jpeg")).quality == 90


def test_the_pixel_of_an_image_without_an_image_is_refused() -> None:
    for texture in [], ["--texture", "grass"]:
        with pytest.raises(ConfigError, match="give --texture IMAGE"):
            simulate.scenario_from(parse("x", "--texture-pixel", "0.1", *texture))
    assert simulate.scenario_from(parse("x", "--texture-pixel", "0.1", "--texture", "a.jpg")).texture_m_per_px == 0.1


@pytest.mark.slow
def test_a_recording_of_objects_in_colour_reads_back_in_colour(tmp_path: Path) -> None:
    out = tmp_path / "flight"
    arguments = "--frames", "2", "--vehicles", "1", "--scale", "0.125", "--objects", "--colour"
    assert simulate.run(parse(str(out), *arguments)) == 0
    frame = next(event for event in open_flight(out, "uav1").iter_events() if isinstance(event, StereoFrame))
    assert frame.left.shape == frame.right.shape == (120, 160, 3)
    blue, green, red = (frame.left[..., k].mean() for k in range(3))
    assert green > blue + 5.0  # vegetation and soil
    assert red > blue + 5.0


def test_what_is_not_given_keeps_the_scenarios_value() -> None:
    scenario = simulate.scenario_from(parse("out", "--scenario", "long", "--imu", "consumer", "--noise", "3"))
    assert (scenario.pattern, scenario.frames, scenario.imu) == ("lawnmower", 1000, "consumer")
    assert scenario.noise_sigma == 3.0
    assert (scenario.objects, scenario.colour) == (False, False)


@pytest.mark.parametrize(("option", "names"), [("scenario", SCENARIOS), ("pattern", PATTERNS), ("imu", IMU_GRADES)])
def test_the_help_names_all_that_is_accepted(option: str, names: dict[str, object]) -> None:
    parser = argparse.ArgumentParser()
    simulate.add_arguments(parser)
    said = next(action.help for action in parser._actions if action.dest == option)
    assert [name for name in names if not re.search(rf"\b{name}\b", said)] == []


def test_an_unknown_scenario_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="kagaru, sample, long"):
        simulate.scenario_from(parse("out", "--scenario", "mars"))
