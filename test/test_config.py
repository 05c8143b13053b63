# SPDX-License-Identifier: Apache-2.0
"""Every wrong key, type and value is refused in one line that names the file, the key, the value and the remedy."""

import dataclasses
import typing
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from uav_vslam.config import (
    EXTRACTORS,
    IMU_GRADES,
    RETENTION_POLICIES,
    STATE_MODELS,
    BackendConfig,
    FrontendConfig,
    FusionConfig,
    ImuConfig,
    ReplayConfig,
    StartConfig,
    VehicleConfig,
    build,
    find_config,
    find_link,
    flatten,
    load,
    load_fleet,
    load_vehicle,
    to_tree,
)
from uav_vslam.cooperation.link import LinkConfig
from uav_vslam.errors import ConfigError
from uav_vslam.estimation.models import MODELS
from uav_vslam.slam.map_manager import RETENTION
from uav_vslam.vision import features

ROOT = Path(__file__).parents[1]
Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def make(text: str, name: str = "given.yaml") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return make


def test_an_empty_file_and_no_file_give_the_defaults(write: Write) -> None:
    assert load_vehicle(write("")) == load_vehicle(write("# nothing\n")) == load_vehicle(None) == VehicleConfig()


def test_a_file_holds_differences_only(write: Write) -> None:
    config = load_vehicle(write("backend: {sigma_px: 2}\nfusion:\n  mode: none\n"))
    assert config.backend == dataclasses.replace(BackendConfig(), sigma_px=2.0)
    assert isinstance(config.backend.sigma_px, float)
    assert config.fusion.mode == "none"
    assert config.imu == ImuConfig()


def test_a_section_without_keys_changes_nothing(write: Write) -> None:
    path = write("backend:\nfusion:\n")
    assert load_vehicle(path) == VehicleConfig()
    assert load_vehicle(path, overrides={"backend.sigma_px": 0.5}).backend.sigma_px == 0.5


def test_overrides_come_last(write: Write) -> None:
    path = write("backend: {sigma_px: 2.0, pnp_px: 3.0}")
    config = load_vehicle(path, overrides={"backend.sigma_px": 0.5, "imu.gravity": 9.81})
    assert (config.backend.sigma_px, config.backend.pnp_px, config.imu.gravity) == (0.5, 3.0, 9.81)


WRONG_VEHICLE = {
    "unknown_key": (
        "backend: {sigma_pix: 1.0}",
        r"given\.yaml: unknown key backend\.sigma_pix; did you mean backend\.sigma_px",
    ),
    "unknown_section": ("backed: {}", r"unknown key backed; did you mean backend\?"),
    "unlike_any_key": ("zzz: 1", "unknown key zzz; known keys: backend, frontend, fusion, imu, rig, start"),
    "number_as_key": ("7: 1", "unknown key 7"),
    "text_for_number": ("backend: {sigma_px: much}", r"given\.yaml: backend\.sigma_px = 'much' must be of type float"),
    "number_for_text": ("fusion: {mode: 3}", r"fusion\.mode = 3 must be of type str"),
    "fraction_for_count": ("backend: {max_landmarks: 200.5}", r"backend\.max_landmarks = 200\.5 must be of type int"),
    "truth_for_count": ("backend: {max_landmarks: true}", r"backend\.max_landmarks = True must be of type int"),
    "truth_for_number": ("backend: {sigma_px: true}", r"backend\.sigma_px = True must be of type float"),
    "null_for_number": ("backend: {sigma_px: null}", r"backend\.sigma_px = None must be of type float"),
    "list_for_section": ("backend: [1, 2]", r"backend must hold keys and values, not \[1, 2\]"),
    "number_for_section": ("backend: 5", "backend must hold keys and values, not 5"),
    "out_of_range": (
        "backend: {sigma_px: -1.0}",
        r"given\.yaml: BackendConfig\.sigma_px = -1\.0 is not allowed; use a positive",
    ),
    "infinite": ("backend: {sigma_px: .inf}", r"backend\.sigma_px = inf must be finite"),
    "not_a_number": ("imu: {gyro_noise: .nan}", r"imu\.gyro_noise = nan must be finite"),
    "inconsistent": (
        "backend: {max_landmarks: 50}",
        r"BackendConfig\.max_landmarks = 50 is not allowed; use at least max_in_view",
    ),
    "unknown_model": (
        "backend: {model: ri16}",
        r"BackendConfig\.model = 'ri16' is not allowed; use one of ri15, so15, euler9",
    ),
    "twice": ("imu: {gravity: 9.8}\nimu: {}", r"given\.yaml: key 'imu' is used twice \(line 2\)"),
    "twice_inside": ("imu:\n  gravity: 9.8\n  gravity: 9.9", r"key 'gravity' is used twice \(line 3\)"),
    "list_as_key": ("? [a, b]\n: 1", r"key \['a', 'b'\] must be a word \(line 1\)"),
    "a_list": ("- backend", "must hold keys and values, not list"),
    "a_word": ("backend", "must hold keys and values, not str"),
    "bad_yaml": ("backend: {sigma_px: 1.0", r"given\.yaml: not valid YAML"),
    "tab": ("backend:\n\tsigma_px: 1.0", r"given\.yaml: not valid YAML"),
    "python_object": ("!!python/object:os.system {}", "not valid YAML"),
}


@pytest.mark.parametrize("kind", sorted(WRONG_VEHICLE))
def test_a_wrong_vehicle_file_is_refused(write: Write, kind: str) -> None:
    text, message = WRONG_VEHICLE[kind]
    with pytest.raises(ConfigError, match=message):
        load_vehicle(write(text))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"backend.sigma_pix": 1.0}, r"overrides: unknown key backend\.sigma_pix"),
        ({"sigma_px": 1.0}, "overrides: unknown key sigma_px"),
        ({"backend.sigma_px": "1"}, r"overrides: backend\.sigma_px = '1' must be of type float"),
        ({"backend.sigma_px": 0.0}, r"overrides: BackendConfig\.sigma_px = 0\.0 is not allowed"),
    ],
)
def test_a_wrong_override_is_refused(overrides: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_vehicle(None, overrides=overrides)


def test_an_override_does_not_hide_a_section_that_is_no_section(write: Write) -> None:
    with pytest.raises(ConfigError, match="backend must hold keys and values, not 5"):
        load_vehicle(write("backend: 5"), overrides={"backend.sigma_px": 1.0})


def test_a_file_that_can_not_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml: can't be read \(No such file or directory\)"):
        load_vehicle(tmp_path / "absent.yaml")
    with pytest.raises(ConfigError, match="can't be read"):
        load_vehicle(tmp_path)  # a folder
    (tmp_path / "image.yaml").write_bytes(b"\xff\xd8\xff\xe0binary")
    with pytest.raises(ConfigError, match=r"image\.yaml: not valid YAML"):
        load_vehicle(tmp_path / "image.yaml")


RANGES = [
    (ImuConfig, "gyro_noise", 0.0),
    (ImuConfig, "gravity", -9.8),
    (FrontendConfig, "scale", 1.5),
    (FrontendConfig, "scale", 0.0),
    (FrontendConfig, "max_features", 0),
    (FrontendConfig, "contrast_threshold", -0.1),
    (FrontendConfig, "ratio", 1.1),
    (FrontendConfig, "epipolar_px", 0.0),
    (FrontendConfig, "min_depth_m", 900.0),
    (FrontendConfig, "max_matches", 0),
    (BackendConfig, "retention", "all"),
    (BackendConfig, "depth_sigma_ratio", -0.1),
    (BackendConfig, "min_descriptor_ratio", 0.0),
    (BackendConfig, "gate_probability", 1.0),
    (BackendConfig, "pnp_px", 0.0),
    (BackendConfig, "iterate_beyond_m", 0.0),
    (BackendConfig, "max_observations", 0),
    (BackendConfig, "max_new_landmarks", -1),
    (BackendConfig, "young_frames", 0),
    (BackendConfig, "min_pnp_inliers", 3),
    (BackendConfig, "min_relocalisation_inliers", 0),
    (BackendConfig, "retention_cell_m", 0.0),
    (FusionConfig, "mode", "narrow"),
    (FusionConfig, "epoch_s", 0.0),
    (FusionConfig, "min_delay_s", -0.1),
    (FusionConfig, "max_packet_landmarks", 0),
    (FusionConfig, "ratio", 0.0),
    (FusionConfig, "gate_probability", 0.0),
    (FusionConfig, "min_common", 0),
    (FusionConfig, "floor_sigma_m", -0.3),
    (StartConfig, "method", "magic"),
    (StartConfig, "rest_s", 0.0),
    (ReplayConfig, "rate", -1.0),
    (ReplayConfig, "timeout_s", 0.0),
]


@pytest.mark.parametrize(("cls", "key", "value"), RANGES, ids=lambda v: getattr(v, "__name__", str(v)))
def test_a_value_out_of_range_is_refused_with_what_is_allowed(cls: type, key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=rf"{cls.__name__}\.{key} = .* is not allowed; use "):
        cls(**{key: value})


def test_compact_packets_want_descriptors_like_sifts() -> None:
    narrowband = FusionConfig(mode="narrowband")
    assert VehicleConfig(fusion=narrowband, frontend=FrontendConfig(extractor="asift")).fusion == narrowband
    with pytest.raises(ConfigError, match="'surf' is not allowed; use one of sift, asift, dsift in narrowband mode"):
        VehicleConfig(fusion=narrowband, frontend=FrontendConfig(extractor="surf"))


def test_every_name_that_can_be_chosen_exists() -> None:
    assert set(STATE_MODELS) == set(MODELS)
    assert set(RETENTION_POLICIES) == set(RETENTION)
    assert set(EXTRACTORS) == set(features.EXTRACTORS)
    assert IMU_GRADES["adis16480"] == ImuConfig()


def test_a_configuration_survives_the_way_through_yaml() -> None:
    config = VehicleConfig(
        imu=IMU_GRADES["consumer"],
        backend=BackendConfig(model="euler9", retention="none", sigma_px=0.3),
        fusion=FusionConfig(mode="none"),
    )
    text = yaml.safe_dump(to_tree(config))
    assert build(VehicleConfig, yaml.safe_load(text), where="round trip") == config
    replay = ReplayConfig(bags=(Path("a"), Path("b/c")), rate=2.0)
    tree = to_tree(replay)
    assert tree["bags"] == ["a", "b/c"]
    assert yaml.safe_load(yaml.safe_dump(tree)) == tree


def test_flattened_keys_are_the_overrides_that_rebuild_the_configuration() -> None:
    config = VehicleConfig(backend=BackendConfig(sigma_px=0.3), start=StartConfig(method="static"))
    flat = flatten(config)
    assert flat["backend.sigma_px"] == 0.3
    assert all(isinstance(value, str | int | float) for value in flat.values())
    assert load_vehicle(None, overrides=flat) == config


def test_every_field_has_a_default_of_its_declared_type() -> None:
    for section in (ImuConfig, FrontendConfig, BackendConfig, FusionConfig, StartConfig):
        hints = typing.get_type_hints(section)
        for field in dataclasses.fields(section):
            assert isinstance(field.default, hints[field.name]), f"{section.__name__}.{field.name}"


def test_a_fleet_file_names_vehicles_bags_and_mode_relative_to_itself(write: Write, tmp_path: Path) -> None:
    write("backend: {sigma_px: 0.7}", "own.yaml")
    fleet = load_fleet(
        write("vehicles: {uav1: {config: own.yaml}, uav2: }\nreplay: {bags: [flight, ../b], rate: 2}\nmode: none\n")
    )
    assert list(fleet.vehicles) == ["uav1", "uav2"]
    assert fleet.vehicles["uav1"].backend.sigma_px == 0.7
    assert fleet.vehicles["uav2"].backend == BackendConfig()
    assert {v.fusion.mode for v in fleet.vehicles.values()} == {"none"}
    assert fleet.replay == ReplayConfig(bags=(tmp_path / "flight", tmp_path / "../b"), rate=2.0)


def test_overrides_reach_every_vehicle_of_a_fleet(write: Write) -> None:
    fleet = load_fleet(write("vehicles: {uav1: , uav2: }\nmode: none"), overrides={"fusion.mode": "wideband"})
    assert {v.fusion.mode for v in fleet.vehicles.values()} == {"wideband"}


WRONG_FLEET = {
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
        r"FusionConfig\.mode = 'radio' is not allowed; use one of wideband, narrowband, none",
    ),
    "replay_as_list": ("vehicles: {uav1: }\nreplay: [flight]", "replay must hold keys and values"),
    "bags_as_text": ("vehicles: {uav1: }\nreplay: {bags: flight}", r"replay\.bags = 'flight' must be a list of paths"),
    "bags_as_numbers": ("vehicles: {uav1: }\nreplay: {bags: [1]}", r"replay\.bags = \[1\] must be a list of paths"),
    "unknown_replay_key": ("vehicles: {uav1: }\nreplay: {speed: 2}", r"replay: unknown key speed"),
    "negative_rate": ("vehicles: {uav1: }\nreplay: {rate: -1}", r"replay: ReplayConfig\.rate = -1\.0 is not allowed"),
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
    with pytest.raises(ConfigError, match=r"'nowhere' is neither a file nor one of ours \(.*kagaru"):
        find_config("nowhere")


@pytest.mark.parametrize("file", sorted((ROOT / "config" / "links").glob("*.yaml")), ids=lambda file: file.stem)
def test_every_link_of_ours_can_be_read_by_its_name(file: Path) -> None:
    assert find_link(file.stem) == find_link(str(file)) == file
    assert load(LinkConfig, file) != LinkConfig()


def test_a_link_file_with_a_wrong_key_or_value_is_refused(tmp_path: Path) -> None:
    (tmp_path / "key.yaml").write_text("los: 0.1\n")
    with pytest.raises(ConfigError, match=r"key\.yaml: unknown key los; did you mean loss\?"):
        load(LinkConfig, tmp_path / "key.yaml")
    (tmp_path / "value.yaml").write_text("blackouts: [[5, 2]]\n")
    with pytest.raises(ConfigError, match="start < end"):
        load(LinkConfig, tmp_path / "value.yaml")
