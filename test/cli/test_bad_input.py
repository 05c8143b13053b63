# SPDX-License-Identifier: Apache-2.0
"""Bad input ends in one line on stderr that says what is wrong, where, and what to do, and in exit code 2."""

import dataclasses
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import refused

from uav_vslam.cli.main import main
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import decode, encode
from uav_vslam.datasets.outputs import read_outputs
from uav_vslam.datasets.rosbag import RawMessage, iter_raw, topics_of
from uav_vslam.evaluation.output import LATEST
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.studies.recordings.foreign import renamed, rewritten, shifted

FRAMES = 8
CUT = 0.6  # of the file's bytes

Edit = Callable[[str, Any], Any]  # topic and message to message, or to None: leave it out


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny flight with which nothing is wrong."""
    path = tmp_path_factory.mktemp("good") / "flight"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=FRAMES, scale=0.125, seed=3), path)
    return path


@pytest.fixture(scope="module")
def cut(good: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, truncated."""
    path = tmp_path_factory.mktemp("cut") / "flight"
    path.mkdir()
    (source,) = good.glob("*.mcap")
    data = source.read_bytes()
    (path / source.name).write_bytes(data[: int(len(data) * CUT)])
    return path


def edited(source: Path, out: Path, edit: Edit) -> Path:
    latched = {topic: info.latched for topic, info in topics_of([source]).items()}
    with RawRecorder(out) as recorder:
        for raw in iter_raw([source]):
            message = edit(raw.topic, decode(raw))
            if message is not None:
                recorder.write(raw.topic, raw.msgtype, encode(message), raw.stamp_ns, latched=latched[raw.topic])
    return out


def without(name: str) -> Edit:
    return lambda topic, message: None if topic == name else message


def changed(name: str, **fields: Any) -> Edit:
    return lambda topic, message: dataclasses.replace(message, **fields) if topic == name else message


def rotated_by_nothing(topic: str, message: Any) -> Any:
    if topic == "/tf_static":
        for stamped in message.transforms:
            stamped.transform.rotation.w = stamped.transform.rotation.x = 0.0
            stamped.transform.rotation.y = stamped.transform.rotation.z = 0.0
    return message


def started_nowhere(topic: str, message: Any) -> Any:
    if topic == "/uav1/initial_state":
        message.velocity.x = float("nan")
    return message


def half_as_high(topic: str, message: Any) -> Any:
    if topic != "/uav1/right/image_raw":
        return message
    height = message.height // 2
    return dataclasses.replace(message, height=height, data=message.data[: height * message.step])


def fleet_file(folder: Path, text: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text)
    return path


BAD_BAGS: dict[str, tuple[Edit, list[str]]] = {
    "no readings": (without("/uav1/imu/data_raw"), ["lacks /uav1/imu/data_raw", "input.topics"]),
    "no right images": (without("/uav1/right/image_raw"), ["lacks /uav1/right/image_raw", "input.topics"]),
    "no camera info": (without("/uav1/right/camera_info"), ["lacks /uav1/right/camera_info", "input.topics"]),
    "no extrinsics": (without("/tf_static"), ["lacks /tf_static", "input.calibration"]),
    "extrinsics of another frame": (
        changed("/uav1/left/camera_info", header=None),
        ["/tf_static does not connect uav1/base_link and nowhere", "Publish that transform"],
    ),
    "uncalibrated camera": (
        changed("/uav1/left/camera_info", k=np.zeros(9)),
        ["/uav1/left/camera_info", "focal length", "K filled in? All faults"],
    ),
    "distortion model we don't know": (
        changed("/uav1/right/camera_info", distortion_model="omni"),
        ["/uav1/right/camera_info", "'omni'", "plumb_bob"],
    ),
    "cameras of two sizes": (
        changed("/uav1/right/camera_info", width=320),
        ["vehicle uav1", "160x120", "320x120", "same size"],
    ),
    "images of another size than calibrated": (
        half_as_high,
        ["/uav1/right/image_raw", "160x60", "160x120", "calibrate at the recorded size, or give K for it: binning"],
    ),
    "images of unknown encoding": (
        changed("/uav1/right/image_raw", encoding="yuv9"),
        ["/uav1/right/image_raw", "image encoding 'yuv9' can't be used; use mono8"],
    ),
    "images that lack pixels": (
        changed("/uav1/left/image_raw", data=np.zeros(9, np.uint8)),
        ["/uav1/left/image_raw", "160x120 px in mono8 holds 9 bytes, with a step of 160"],
    ),
    "extrinsics that are no rotation": (
        rotated_by_nothing,
        ["/tf_static, uav1/base_link to uav1/", "zero norm", "publish a corrected transform"],
    ),
    "start state that is no number": (
        started_nowhere,
        ["/uav1/initial_state", "velocity holds NaN", "record a start state that is valid"],
    ),
}


def bad_bag(case: str, good: Path, out: Path) -> Path:
    edit, _ = BAD_BAGS[case]
    if case == "extrinsics of another frame":
        header = decode(next(iter_raw([good], ["/uav1/left/camera_info"]))).header
        edit = changed("/uav1/left/camera_info", header=dataclasses.replace(header, frame_id="nowhere"))
    return edited(good, out, edit)


@pytest.mark.parametrize("case", BAD_BAGS)
def test_a_bag_that_lacks_or_contradicts_something_is_refused_by_run_and_launch(
    case: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bad_bag(case, good, tmp_path / "bag")
    fleet = fleet_file(tmp_path, "vehicles: {uav1: {}}\nreplay: {bags: [bag]}\n")
    for line in (refused(capsys, "run", bag, "--results", tmp_path / "out"), refused(capsys, "launch", fleet)):
        for said in [*BAD_BAGS[case][1], str(bag)] if "tf_static does" not in line else BAD_BAGS[case][1]:
            assert said in line
    assert not (tmp_path / "out").exists()


def test_a_start_state_that_nobody_gave_is_told_with_both_remedies(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, "run", edited(good, tmp_path / "bag", without("/uav1/initial_state")))
    assert "no uav1/initial_state" in line
    assert "start.method: static" in line


def test_a_start_in_a_map_without_a_map_is_told_before_the_flight(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, "run", good, "--set", "start.method=map", "--results", tmp_path / "out")
    assert "start.method: map needs a map of an earlier flight; set start.map (--map)" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [("nowhere", None, "does not exist"), ("text.mcap", "hello", "is damaged"), ("notes.txt", "hello", "is not a bag")],
)
def test_what_is_no_bag_is_named(
    name: str, content: str | None, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    line = refused(capsys, "run", tmp_path / name)
    assert said in line
    assert str(tmp_path / name) in line


@pytest.mark.parametrize("verb", ["run", "check", "evaluate", "map", "launch"])
def test_a_bag_that_is_given_twice_is_refused(
    verb: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its messages would count twice: images repeat, and pairs are torn."""
    (tmp_path / "link").symlink_to(good)
    (file,) = good.glob("*.mcap")
    for again in (good, tmp_path / "link", file):
        fleet = fleet_file(tmp_path, f"vehicles: {{uav1: {{}}}}\nreplay: {{bags: [{good}, {again}]}}\n")
        line = refused(capsys, verb, *([fleet] if verb == "launch" else [good, again]))
        assert f"bag {again} holds what {good} holds, {file.name}: give each recording once" in line


def test_a_vehicle_that_was_not_recorded_is_named_with_what_was(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path, f"vehicles: {{ghost: {{}}}}\nreplay: {{bags: [{good}]}}\n")
    for arguments in (["run", fleet], ["launch", fleet], ["run", good, "--vehicles", "ghost"]):
        line = refused(capsys, *arguments)
        assert "/ghost/left/image_raw" in line
        assert "/uav1/left/image_raw" in line


@pytest.mark.parametrize("verb", ["run", "launch"])
def test_an_unknown_key_is_told_with_file_and_the_nearest_known_one(
    verb: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.yaml").write_text("/**: {ros__parameters: {backend: {sigma_pxx: 1.0}}}\n")
    fleet = fleet_file(tmp_path, f"vehicles: {{uav1: {{config: mine.yaml}}}}\nreplay: {{bags: [{good}]}}\n")
    line = refused(capsys, verb, fleet)
    assert f"{tmp_path / 'mine.yaml'}: unknown key backend.sigma_pxx; did you mean backend.sigma_px?" in line


@pytest.mark.parametrize("verb", ["run", "launch"])
def test_a_link_that_there_is_not_or_that_is_impossible_is_told(
    verb: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path, f"vehicles: {{uav1: {{}}}}\nreplay: {{bags: [{good}]}}\n")
    line = refused(capsys, verb, fleet, "--link", "lossless")
    assert "link 'lossless' is neither a file nor one of ours (bad_radio, blackouts, clean, wifi)" in line
    (tmp_path / "link.yaml").write_text("/**: {ros__parameters: {link: {loss: 2.0}}}\n")
    line = refused(capsys, verb, fleet, "--link", tmp_path / "link.yaml")
    assert f"{tmp_path / 'link.yaml'}: link.loss = 2.0 is not allowed" in line
    assert "connects vehicles, and " in refused(capsys, verb, fleet, "--link", "clean")


def test_a_rate_without_recordings_to_replay_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = fleet_file(tmp_path, "vehicles: {uav1: {}}\n")
    assert f"{fleet} names no recordings to replay" in refused(capsys, "launch", fleet, "--rate", "1")


FLEETS = {
    "vehicles: [uav1]": "'vehicles' must map at least one name",
    "- uav1": "must hold keys and values, not list",
    "vehicles: {1uav: {}}": "'1uav' must be a valid ROS namespace",
    "vehicles: {uav1: {config: 3}}": "must look like {config: kagaru.yaml}",
    "vehicles: {uav1: {}}\nreplay: {bags: bag}": "use a list of paths",
    "vehicles: {uav1: {}}\nreplay: {bags: [bag], rate: fast}": "rate = 'fast' is not allowed",
    "vehicles: {uav1: {}}\nreplay: {bags: [bag], rate: -1}": "rate = -1 is not allowed",
    "vehicles: {uav1: {}}\nreplay: 7": "replay must hold keys and values",
    "vehicles: {uav1: {}}\nmode: loud": "mode = 'loud' is not allowed; use one of wideband, narrowband, none",
    "vehicles: {uav1: {}}\nradio: {domain_id: 400}": "domain_id = 400 is not allowed",
    "vehicles: {uav1: {": "not valid YAML",
}


@pytest.mark.parametrize("text", FLEETS)
def test_a_wrong_fleet_file_is_named_with_what_is_wrong(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path, text)
    for verb in ("run", "launch", "check"):
        line = refused(capsys, verb, fleet)
        assert str(fleet) in line
        assert FLEETS[text] in line


@pytest.mark.parametrize("verb", ["run", "launch"])
def test_a_vehicle_named_twice_is_told_with_its_line(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path, "vehicles:\n  uav1: {}\n  uav1: {}\n")
    line = refused(capsys, verb, fleet)
    assert f"{fleet}: not valid YAML: key 'uav1' is used twice (line 3)" in line


def test_what_a_fleet_file_says_itself_is_not_taken_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path, "vehicles: {uav1: {}}\nreplay: {bags: [bag]}\n")
    for more in (["another_bag"], ["--config", "kagaru"], ["--vehicles", "uav1"]):
        assert "is a fleet file" in refused(capsys, "run", fleet, *more)
    assert "is a fleet file" in refused(capsys, "run", "another_bag", fleet)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "bag", "--workers", "0"], "'0' is not a count of at least 1"),
        (["study", "models", "--seeds", "-1"], "'-1' is not a count of at least 1"),
        (["study", "models", "--first-seed", "-1"], "'-1' is not a whole number of at least 0"),
        (["run", "bag", "--results", "FILE/results"], "results: can't be made"),
        (["run", "bag", "--results", "/proc/results"], "results: can't be made"),
        (["run", "bag", "--results", "WITH_LATEST"], "latest is not a symbolic link"),
    ],
)
def test_arguments_that_can_not_work_are_refused_before_anything_begins(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "with" / LATEST).mkdir(parents=True)
    given = [a.replace("FILE", f"{tmp_path}/file").replace("WITH_LATEST", f"{tmp_path}/with") for a in arguments]
    with pytest.raises(SystemExit) as left:
        main(given)
    assert left.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("setting", ["backend.filter=[1", "frames.map=2026-02-30"])
def test_a_value_that_is_no_yaml_is_told(setting: str, good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"'{setting}': the value is not YAML" in refused(capsys, "run", good, "--set", setting)


def test_a_vehicle_named_twice_on_the_command_line_is_told(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "names one twice" in refused(capsys, "run", good, "--vehicles", "uav1", "/uav1/")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("evaluate", "--max-gap", "2"), "--max-gap serves files and results folders"),
        (("evaluate", "--times", "times.txt"), "--times serves files and results folders"),
        (("mosaic", "--method", "homography", "--height", "70"), "has no use for --height"),
        (("import", "kitti", "out", "--first-frame", "3"), "--first-frame goes with --oxts"),
    ],
)
def test_options_without_effect_are_refused(
    arguments: tuple[str, ...], said: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    verb, *others = arguments
    source = [str(good)] if verb != "import" else []
    if verb == "import":
        others = [others[0], str(good), str(tmp_path / others[1]), *others[2:]]
    assert said in refused(capsys, verb, *source, *others)


def test_topics_of_other_names_and_in_the_root_come_with_the_command_that_proposes_their_names(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def in_root(raw: RawMessage) -> RawMessage:
        return dataclasses.replace(raw, topic=raw.topic.removeprefix("/uav1"))

    for name, change in (("root", in_root), ("driver", renamed)):
        bag = rewritten(good, tmp_path / name, change)
        line = refused(capsys, "run", bag)
        assert f"bag {bag} holds no <vehicle>/left/image_raw" in line
        assert line.rstrip().endswith(f"uav-vslam check {bag}")


def test_a_namespace_of_several_levels_is_refused_before_the_flight(
    good: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, "run", good, "--vehicles", "fleet/uav1")
    assert "--set input.topics.left=/fleet/uav1/left/image_raw" in said


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("backend.sigma_px=-1", "use a number of at least 0.01 [px]"),
        ("backend.sigma_px=abc", "backend.sigma_px = 'abc' is not allowed; use a number"),
        ("backend.nope=1", "unknown key backend.nope"),
        ("backend", "must have the form KEY=VALUE"),
        ("backend.max_landmarks=1.5", "use a whole number of at least 1"),
        ("backend.sigma_px=nan", "use a number of at least 0.01 [px]"),
        ("backend=3", "backend must hold keys and values"),
    ],
)
def test_a_wrong_override_is_told(setting: str, said: str, good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert said in refused(capsys, "run", good, "--set", setting)


def test_the_check_that_is_advised_can_be_pasted_and_needs_the_settings_of_the_run(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without them it would judge other topics."""
    spaced = tmp_path / "my flight"
    spaced.symlink_to(good)
    line = refused(capsys, "run", spaced, "--set", "input.topics.imu=nowhere")
    assert line.rstrip().endswith(f"All faults: uav-vslam check '{spaced}', with the same configuration")
    assert f"are given together: '{spaced}'" in refused(capsys, "run", tmp_path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--set", "backend.sigma_px=0.5", "--set", "backend.sigma_px=0.8"], "sigma_px is given twice, 0.5 and 0.8"),
        (["--set", "fusion.mode=none", "--mode", "wideband"], "fusion.mode is given twice, by --set and by an option"),
    ],
)
def test_a_setting_that_is_given_twice_is_refused(
    options: list[str], said: str, good: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in refused(capsys, "run", good, *options)


def test_a_wrong_value_is_looked_for_where_it_stands(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("/**: {ros__parameters: {backend: {sigma_px: 0.5}}}")
    line = refused(capsys, "run", good, "--config", file, "--set", "backend.sigma_px=-1")
    assert f": overrides of {file}: backend.sigma_px = -1 is not allowed" in line
    file.write_text("/**: {ros__parameters: {backend: {sigma_px: -2}}}")
    line = refused(capsys, "run", good, "--config", file, "--set", "imu.gyro_noise=-1")
    assert f": {file}: backend.sigma_px = -2 is not allowed" in line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["simulate", "NEW", "--noise", "-3"], "noise_sigma -3.0 is not allowed"),
        (["simulate", "NEW", "--frames", "0"], "use 2 to 1000000 frames"),
        (["simulate", "NEW", "--texture", "nothing.jpg"], "'nothing.jpg' is neither 'grass' nor an image"),
        (["simulate", "FOLDER"], "choose a folder that does not exist yet"),
        (["simulate", "/proc/flight"], "can't record to /proc/flight: No such file or directory; choose another place"),
        (["import", "euroc", "NEW", "NEW"], "new is not a folder; name the one that holds the data set"),
        (["import", "kitti", "FOLDER", "NEW"], "folder has no calib.txt; give the folder of one sequence"),
        (["report", "NEW"], "new holds no summary.json; name the results of a flight"),
        (["export", "NEW", "--format", "tum"], "No such file or directory; name a trajectory file"),
        (["evaluate", "NEW"], "does not exist"),
        (["evaluate", "BAG", "NEW"], "/new does not exist"),
        (["launch", "FOLDER"], "Is a directory"),
        (["launch", "NEW"], "No such file"),
        (["check", "FOLDER"], "is not a bag"),
        (["map", "PICTURES"], "it holds pictures, which are joined by: uav-vslam mosaic"),
        (["run", "RESULTS"], "it holds results: name the recording, or see uav-vslam map"),
        (["run", "FOLDER", "--config", "NEW"], "neither a file nor one of ours"),
    ],
)
def test_wrong_paths_and_numbers_are_told(
    arguments: list[str], said: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, files in {"folder": [], "pictures": ["DJI_0001.JPG"], "results": ["summary.json", "errors.png"]}.items():
        (tmp_path / name).mkdir()
        for file in files:
            (tmp_path / name / file).touch()
    places = ("folder", "pictures", "results", "new")
    paths = {name.upper(): str(tmp_path / name) for name in places} | {"BAG": str(good)}
    assert said in refused(capsys, *(paths.get(argument, argument) for argument in arguments))


@pytest.mark.ros
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--map", "FILE/map"], "map/uav1: can't be made"),
        (["--map", "/proc/map"], "/proc/map/uav1: can't be made"),
        (["--map", "FOLDER"], "folder/uav1/tiles already holds a height grid"),
        (["--record", "FILE/bag"], "bag: can't be made"),
        (["--record", "FOLDER"], "folder exists already"),
    ],
)
def test_places_that_can_not_be_made_are_told_before_a_fleet_starts(
    options: list[str], said: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "folder/uav1/tiles").mkdir(parents=True)
    (tmp_path / "folder/uav1/tiles/grid.json").touch()
    (tmp_path / "file").write_text("no folder")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"vehicles: {{uav1: {{}}}}\nreplay: {{bags: [{good}]}}\n")
    paths = [text.replace("FILE", f"{tmp_path}/file").replace("FOLDER", f"{tmp_path}/folder") for text in options]
    assert said in refused(capsys, "launch", fleet, *paths)
    assert {path.name for path in tmp_path.iterdir()} == {"folder", "file", "fleet.yaml"}


@pytest.mark.ros
@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("fusion: {fleet_key_file: /none.key}", "/none.key: the key"),
        ("start: {method: map, map: /none.map}", "/none.map: the map"),
    ],
)
def test_files_of_a_vehicle_that_can_not_be_read_are_told_before_a_fleet_starts(
    setting: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "vehicle.yaml").write_text(f"/**: {{ros__parameters: {{{setting}}}}}\n")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("vehicles: {uav1: {config: vehicle.yaml}, uav2: {config: vehicle.yaml}}\n")
    assert f"{said} can't be read (No such file" in refused(capsys, "launch", fleet)


def test_a_truncated_bag_is_run_up_to_the_damage(cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "run", cut, "--results", tmp_path, "--no-plots")
    assert f"bag {cut / 'flight.mcap'} is damaged" in line
    assert "read up to the damage after stamp" in line
    poses = (tmp_path / LATEST / "uav1_s_slam.tum").read_text().splitlines()
    assert 1 < len(poses) < FRAMES


@pytest.mark.ros
@pytest.mark.slow
def test_a_truncated_bag_is_replayed_up_to_the_damage(
    cut: Path,
    launched: Callable[..., AbstractContextManager[Any]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    fleet = fleet_file(tmp_path, f"vehicles: {{uav1: {{}}}}\nreplay: {{bags: [{cut}]}}\n")
    refused(capsys, "run", fleet, "--results", tmp_path / "twin", "--no-plots")
    with launched(str(fleet), "--record", str(tmp_path / "estimates")) as graph:
        output, _ = graph.process.communicate()
        assert graph.process.returncode == 2, output
        assert graph.running() == []
    assert f"bag {cut / 'flight.mcap'} is damaged: read up to the damage" in output
    assert "Traceback" not in output
    outputs, _ = read_outputs([tmp_path / "estimates"])
    poses = (tmp_path / "twin" / LATEST / "uav1_s_slam.tum").read_text().splitlines()
    assert len(outputs["uav1"].own_only) == len(outputs["uav1"].fused) == len(poses) > 1


def three_milliseconds_late(topic: str, message: Any) -> Any:
    return shifted(message, 3_000_000) if topic == "/uav1/right/image_raw" else message


def test_stereo_stamps_apart_are_reported_and_beyond_the_tolerance_no_run_succeeds(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, results = edited(good, tmp_path / "bag", three_milliseconds_late), tmp_path / "out"
    assert main(["run", str(bag), "--no-plots", "--results", str(results)]) == 0
    said = capsys.readouterr()
    assert "stamped 3.0 ms apart" in said.err
    assert f"{FRAMES} of {FRAMES} frames" in said.out
    line = refused(capsys, "run", bag, "--set", "input.pair_tolerance_s=0.002", "--results", tmp_path / "none")
    for text in (f"none of {FRAMES} frames was processed", f"unpaired {FRAMES}", "3 ms apart", "pair_tolerance_s"):
        assert text in line
