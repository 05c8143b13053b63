# SPDX-License-Identifier: Apache-2.0
"""Every wrong key, type and value is refused in one line that names the file, the key, the value and the remedy."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from uav_vslam.config import (
    IMU_GRADES,
    BackendConfig,
    FusionConfig,
    ImuConfig,
    LinkConfig,
    ReplayConfig,
    VehicleConfig,
    find_config,
    load_fleet,
    load_link,
    load_vehicle,
    parameter_file,
)
from uav_vslam.errors import ConfigError

ROOT = Path(__file__).parents[2]
Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a writer of files as they are."""

    def make(text: str, name: str = "given.yaml") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return make


@pytest.fixture
def write_vehicle(write: Write) -> Write:
    """Return a writer of parameter files, given what stands below `ros__parameters`."""

    def make(text: str, name: str = "given.yaml") -> Path:
        return write("/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in text.splitlines()), name)

    return make


def test_an_empty_file_and_no_file_give_the_defaults(write: Write) -> None:
    assert load_vehicle(write("")) == load_vehicle(write("# nothing\n")) == load_vehicle(None) == VehicleConfig()


def test_a_file_holds_differences_only(write_vehicle: Write) -> None:
    config = load_vehicle(write_vehicle("backend: {sigma_px: 2}\nfusion:\n  mode: none\n"))
    assert config.backend == dataclasses.replace(BackendConfig(), sigma_px=2.0)
    assert isinstance(config.backend.sigma_px, float)
    assert config.fusion.mode == "none"
    assert config.imu == ImuConfig()


def test_a_section_without_keys_changes_nothing(write_vehicle: Write) -> None:
    path = write_vehicle("backend:\nfusion:\n")
    assert load_vehicle(path) == VehicleConfig()
    assert load_vehicle(path, overrides={"backend.sigma_px": 0.5}).backend.sigma_px == 0.5


def test_overrides_come_last(write_vehicle: Write) -> None:
    path = write_vehicle("backend: {sigma_px: 2.0, pnp_px: 3.0}")
    config = load_vehicle(path, overrides={"backend.sigma_px": 0.5, "imu.gravity": 9.81})
    assert (config.backend.sigma_px, config.backend.pnp_px, config.imu.gravity) == (0.5, 3.0, 9.81)


WRONG_VEHICLE = {
    "unknown_key": (
        "backend: {sigma_pix: 1.0}",
        r"given\.yaml: unknown key backend\.sigma_pix; did you mean backend\.sigma_px",
    ),
    "unknown_section": ("backed: {}", r"unknown key backed; did you mean backend\?"),
    "unlike_any_key": (
        "zzz: 1",
        "unknown key zzz; known keys: backend, frames, frontend, fusion, imu, input, rig, start",
    ),
    "number_as_key": ("7: 1", "unknown key 7"),
    "text_for_number": (
        "backend: {sigma_px: much}",
        r"given\.yaml: backend\.sigma_px = 'much' is not allowed; use a number of at least 0.01 \[px\]",
    ),
    "number_for_text": ("fusion: {mode: 3}", r"fusion\.mode = 3 is not allowed; use one of wideband, narrowband, none"),
    "fraction_for_count": ("backend: {max_landmarks: 200.5}", r"max_landmarks = 200\.5 .* use a whole number"),
    "truth_for_count": ("backend: {max_landmarks: true}", r"max_landmarks = True is not allowed; use a whole number"),
    "truth_for_number": ("backend: {sigma_px: true}", r"backend\.sigma_px = True is not allowed; use a number"),
    "null_for_number": ("backend: {sigma_px: null}", r"backend\.sigma_px = None is not allowed; use a number"),
    "list_for_section": ("backend: [1, 2]", r"backend must hold keys and values, not \[1, 2\]"),
    "number_for_section": ("backend: 5", "backend must hold keys and values, not 5"),
    "section_for_number": ("backend: {sigma_px: {x: 1}}", r"unknown key backend\.sigma_px\.x; did you mean backend"),
    "out_of_range": (
        "backend: {sigma_px: -1.0}",
        r"given\.yaml: backend\.sigma_px = -1\.0 is not allowed; use a number of at least 0.01",
    ),
    "infinite": ("backend: {sigma_px: .inf}", r"backend\.sigma_px = inf is not allowed"),
    "not_a_number": ("imu: {gyro_noise: .nan}", r"imu\.gyro_noise = nan is not allowed"),
    "inconsistent": (
        "backend: {max_landmarks: 50}",
        r"backend\.max_landmarks = 50 is not allowed; use at least max_in_view, which is 120",
    ),
    "inconsistent_sections": (
        "fusion: {mode: narrowband}\nfrontend: {extractor: surf}",
        r"frontend\.extractor = 'surf' is not allowed; use one of sift, asift, dsift in narrowband mode",
    ),
    "twice": ("imu: {gravity: 9.8}\nimu: {}", r"given\.yaml: not valid YAML: key 'imu' is used twice \(line 4\)"),
    "twice_inside": ("imu:\n  gravity: 9.8\n  gravity: 9.9", r"key 'gravity' is used twice \(line 5\)"),
    "twice_dotted": ("imu:\n  gravity: 9.8\nimu.gravity: 9.9", r"key 'imu\.gravity' is used twice"),
    "list_as_key": ("? [a, b]\n: 1", r"key \['a', 'b'\] must be a word \(line 3\)"),
    "a_list": ("- backend", r"ros__parameters must hold keys and values, not \['backend'\]"),
    "bad_yaml": ("backend: {sigma_px: 1.0", r"given\.yaml: not valid YAML"),
    "bad_date": (
        "frames:\n  map: 2026-02-30",
        r"valid YAML: '2026-02-30' is no timestamp .* \(line 4\)",
    ),
    "tab": ("backend:\n\tsigma_px: 1.0", r"given\.yaml: not valid YAML"),
    "python_object": ("backend: !!python/object:os.system {}", "not valid YAML"),
}


@pytest.mark.parametrize("kind", sorted(WRONG_VEHICLE))
def test_a_wrong_vehicle_file_is_refused(write_vehicle: Write, kind: str) -> None:
    text, message = WRONG_VEHICLE[kind]
    with pytest.raises(ConfigError, match=message):
        load_vehicle(write_vehicle(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("backend: {sigma_px: 1.0}", r"given\.yaml: must be a ROS parameter file: put everything below '/\*\*:' and"),
        ("/**: {backend: {sigma_px: 1.0}}", "indented, 'ros__parameters:'"),
        ("/**: {ros__parameters: {}}\n/uav1/fusion: {ros__parameters: {}}", "must be a ROS parameter file"),
        ("/**: 5", "must be a ROS parameter file"),
        ("vehicles: {uav1: }", r"given\.yaml is a fleet file: give it to run or launch"),
        ("- backend", "must hold keys and values, not list"),
        ("backend", "must hold keys and values, not str"),
    ],
)
def test_a_file_that_is_no_ros_parameter_file_is_refused(write: Write, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_vehicle(write(text))


@pytest.mark.parametrize("text", ["1", "1.0", "1e0", "1.e+0", "'1'"])
def test_a_number_may_be_written_in_any_way(write_vehicle: Write, text: str) -> None:
    path = write_vehicle(f"backend: {{sigma_px: {text}}}")
    assert load_vehicle(path).backend.sigma_px == 1.0
    assert isinstance(load_vehicle(path).backend.sigma_px, float)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"backend.sigma_pix": 1.0}, r"overrides: unknown key backend\.sigma_pix"),
        ({"sigma_px": 1.0}, "overrides: unknown key sigma_px"),
        ({"backend.sigma_px": "one"}, r"overrides: backend\.sigma_px = 'one' is not allowed"),
        ({"backend.sigma_px": 0.0}, r"overrides: backend\.sigma_px = 0\.0 is not allowed"),
        ({"frontend": {"method": "sift"}}, r"frontend is a group of settings; give each by its name, as frontend\.m"),
    ],
)
def test_a_wrong_override_is_refused(overrides: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_vehicle(None, overrides=overrides)


def test_an_override_does_not_hide_a_section_that_is_no_section(write_vehicle: Write) -> None:
    with pytest.raises(ConfigError, match="backend must hold keys and values, not 5"):
        load_vehicle(write_vehicle("backend: 5"), overrides={"backend.sigma_px": 1.0})


def test_a_file_that_can_not_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml: can't be read \(No such file or directory\)"):
        load_vehicle(tmp_path / "absent.yaml")
    with pytest.raises(ConfigError, match="can't be read"):
        load_vehicle(tmp_path)  # a folder
    (tmp_path / "image.yaml").write_bytes(b"\xff\xd8\xff\xe0binary")
    with pytest.raises(ConfigError, match=r"image\.yaml: not valid YAML"):
        load_vehicle(tmp_path / "image.yaml")


def test_a_configuration_survives_the_way_through_a_file(write: Write) -> None:
    config = VehicleConfig(
        imu=IMU_GRADES["consumer"],
        backend=BackendConfig(model="euler9", retention="none", sigma_px=0.3),
        fusion=FusionConfig(mode="none"),
    )
    assert load_vehicle(write(yaml.safe_dump(parameter_file({"/**": config})))) == config


def test_a_fleet_file_names_vehicles_bags_and_mode_relative_to_itself(
    write: Write, write_vehicle: Write, tmp_path: Path
) -> None:
    write_vehicle("backend: {sigma_px: 0.7}", "own.yaml")
    fleet = load_fleet(
        write("vehicles: {uav1: {config: own.yaml}, uav2: }\nreplay: {bags: [flight, ../b], rate: 2}\nmode: none\n")
    )
    assert list(fleet.vehicles) == ["uav1", "uav2"]
    assert fleet.vehicles["uav1"].backend.sigma_px == 0.7
    assert fleet.vehicles["uav2"].backend == BackendConfig()
    assert {v.fusion.mode for v in fleet.vehicles.values()} == {"none"}
    assert fleet.replay == ReplayConfig(bags=(tmp_path / "flight", tmp_path / "../b"), rate=2.0)


def test_paths_in_a_vehicles_file_are_relative_to_it_and_overrides_to_the_working_folder(
    write: Write, write_vehicle: Write, tmp_path: Path
) -> None:
    keys = "fusion: {signing_key_file: ~/own.pem, peer_keys_folder: ../keys}"
    own = write_vehicle(f"start: {{map: a/map.npz}}\n{keys}", "own.yaml")
    fleet = load_fleet(write("vehicles: {uav1: {config: own.yaml}}"))
    for config in (fleet.vehicles["uav1"], load_vehicle(own)):
        assert config.start.map == str(tmp_path / "a" / "map.npz")
        assert config.fusion.signing_key_file == str(Path.home() / "own.pem")
        assert config.fusion.peer_keys_folder == str(tmp_path.parent / "keys")
    assert load_vehicle(own, overrides={"start.map": "b.npz"}).start.map == "b.npz"


@pytest.mark.parametrize("key", ["start: {map: %s}", "fusion: {fleet_key_file: %s}", "input: {calibration: [%s]}"])
def test_a_path_below_the_folder_of_nobody_is_refused(write_vehicle: Write, key: str) -> None:
    own = write_vehicle(key % "~nobody_here/file", "own.yaml")
    with pytest.raises(ConfigError, match=r"own\.yaml: .* ~nobody_here/file: there is no such user"):
        load_vehicle(own)


def test_overrides_reach_every_vehicle_of_a_fleet(write: Write) -> None:
    fleet = load_fleet(write("vehicles: {uav1: , uav2: }\nmode: none"), overrides={"fusion.mode": "wideband"})
    assert {v.fusion.mode for v in fleet.vehicles.values()} == {"wideband"}


WRONG_FLEET = {
    "of_a_vehicle": ("/**: {ros__parameters: {}}", r"is a vehicle's parameter file; .*: \{uav1: \{config: given"),
    "no_vehicles": ("mode: none", r"given\.yaml: 'vehicles' must map at least one name"),
    "empty_vehicles": ("vehicles: {}", "'vehicles' must map at least one name"),
    "listed_vehicles": ("vehicles: [uav1]", "'vehicles' must map at least one name"),
    "twice": ("vehicles:\n  uav1:\n  uav1:\n", r"key 'uav1' is used twice \(line 3\)"),
    "bad_name": ("vehicles: {uav-1: }", "vehicle name 'uav-1' must be a valid ROS namespace"),
    "number_as_name": ("vehicles: {1: }", "vehicle name 1 must be a valid ROS namespace"),
    "foreign_letters": ("vehicles: {größe: }", "must be a valid ROS namespace"),
    "unknown_key": ("vehicles: {uav1: }\nmods: none", r"unknown key mods; did you mean mode\?"),
    "unknown_vehicle_key": ("vehicles: {uav1: {confg: a.yaml}}", r"unknown key vehicles\.uav1\.confg; did you mean"),
    "vehicle_as_text": (
        "vehicles: {uav1: own.yaml}",
        r"vehicles\.uav1 = 'own\.yaml' must look like \{config: kagaru\.yaml\}",
    ),
    "config_as_number": ("vehicles: {uav1: {config: 3}}", r"vehicles\.uav1 = .* must look like"),
    "absent_config": ("vehicles: {uav1: {config: absent.yaml}}", r"absent\.yaml: can't be read"),
    "wrong_mode": (
        "vehicles: {uav1: }\nmode: radio",
        r"given\.yaml: mode = 'radio' is not allowed; use one of wideband, narrowband, none",
    ),
    "replay_as_list": ("vehicles: {uav1: }\nreplay: [flight]", "replay must hold keys and values"),
    "bags_as_text": (
        "vehicles: {uav1: }\nreplay: {bags: flight}",
        r"bags = 'flight' is not allowed; use a list of paths",
    ),
    "bags_as_numbers": (
        "vehicles: {uav1: }\nreplay: {bags: [1]}",
        r"bags = \[1\] is not allowed; use a list of paths",
    ),
    "unknown_replay_key": ("vehicles: {uav1: }\nreplay: {speed: 2}", r"replay: unknown key speed"),
    "negative_rate": ("vehicles: {uav1: }\nreplay: {rate: -1}", r"replay: rate = -1 is not allowed"),
}


@pytest.mark.parametrize("kind", sorted(WRONG_FLEET))
def test_a_wrong_fleet_file_is_refused(write: Write, kind: str) -> None:
    text, message = WRONG_FLEET[kind]
    with pytest.raises(ConfigError, match=message):
        load_fleet(write(text))


def test_a_configuration_is_found_by_path_or_by_name(write: Write) -> None:
    path = write("")
    assert find_config(str(path)) == path
    assert find_config("kagaru") == find_config("kagaru.yaml")
    assert load_vehicle(find_config("kagaru"))
    with pytest.raises(ConfigError, match="'nowhere' is neither a file nor one of ours") as refused:
        find_config("nowhere")
    offered = str(refused.value).partition("(")[2].rstrip(")").split(", ")
    assert "kagaru" in offered
    for name in offered:
        load_vehicle(find_config(name))


@pytest.mark.parametrize("file", sorted((ROOT / "config" / "links").glob("*.yaml")), ids=lambda file: file.stem)
def test_every_link_of_ours_can_be_read_by_its_name(file: Path) -> None:
    assert load_link(file.stem) == load_link(str(file)) != LinkConfig()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("link: {los: 0.1}", r"given\.yaml: unknown key link\.los; did you mean link\.loss\?"),
        ("link: {blackouts: [5, 2]}", r"link\.blackouts = \(5\.0, 2\.0\) is not allowed; use pairs start, end"),
        ("link: {blackouts: [5, 7, 8]}", "use pairs start, end"),
    ],
)
def test_a_link_file_with_a_wrong_key_or_value_is_refused(write_vehicle: Write, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_link(str(write_vehicle(text)))


def test_a_fleet_of_several_computers_has_addresses_on_a_radio(write: Write) -> None:
    text = "vehicles: {a: {address: 10.77.0.1}, b: {address: 10.77.0.2}}\nradio: {domain_id: 42, interface: wlan0}"
    fleet = load_fleet(write(text))
    assert fleet.addresses == {"a": "10.77.0.1", "b": "10.77.0.2"}
    assert (fleet.radio.domain_id, fleet.radio.interface) == (42, "wlan0")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vehicles: {a: {address: 10.77.0.1}, b: }", "b has none"),
        ("vehicles: {a: {address: computer-a}}", "vehicles.a.address = 'computer-a' must be like 10.77.0.1"),
        ("vehicles: {a: {address: 10.77.0.1}}", "which has no ROS domain; set radio.domain_id"),
        ("vehicles: {a: {address: 10.77.0.1}, b: {address: 10.77.0.1}}", "a, b have one address on the radio"),
        ("vehicles: {a: }\nradio: {domain: 42}", "unknown key domain"),
        ("vehicles: {a: }\nradio: 42", "radio must hold keys and values"),
    ],
)
def test_a_wrong_radio_is_refused(write: Write, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_fleet(write(text))
