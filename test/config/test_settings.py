# SPDX-License-Identifier: Apache-2.0
"""A setting's metadata is what its values are checked by, wherever they come from."""

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from uav_vslam.config import (
    EXTRACTORS,
    IMU_GRADES,
    RETENTION_POLICIES,
    STATE_MODELS,
    BackendConfig,
    FrontendConfig,
    FusionConfig,
    ImuConfig,
    InputConfig,
    LinkConfig,
    ReplayConfig,
    RigConfig,
    StartConfig,
    VehicleConfig,
)
from uav_vslam.config.nodes import NODES
from uav_vslam.config.settings import Settings, all_settings, build, differences, flatten, replaced, setting
from uav_vslam.config.vehicle import OutputFramesConfig
from uav_vslam.errors import ConfigError
from uav_vslam.estimation.models import MODELS
from uav_vslam.slam.map_manager import RETENTION
from uav_vslam.vision import features

CLASSES = (VehicleConfig, *(node.own for node in NODES.values()))


@dataclass(frozen=True, slots=True)
class Inner(Settings):
    share: float = setting(0.5, "a share", above=0, at_most=1)
    width_m: float = setting(1.0, "a width", unit="m", at_least=0, below=10)
    count: int = setting(3, "a count", at_least=1)
    on: bool = setting(False, "a switch")


@dataclass(frozen=True, slots=True)
class Outer(Settings):
    kind: str = setting("a", "a choice", choices=("a", "b"))
    names: tuple[str, ...] = setting((), "names")
    times_s: tuple[float, ...] = setting((), "times", unit="s")
    files: tuple[Path, ...] = setting((), "files")
    inner: Inner = field(default_factory=Inner)

    def _check_together(self) -> None:
        if self.kind == "b" and self.inner.on:
            raise ConfigError("kind = 'b' is not allowed; use a with inner.on")


@pytest.mark.parametrize(
    ("name", "given", "value"),
    [
        ("inner.share", 1, 1.0),
        ("inner.share", "1e-3", 1e-3),
        ("inner.width_m", 0, 0.0),
        ("inner.count", 1, 1),
        ("inner.on", True, True),
        ("kind", "b", "b"),
        ("names", ["x", ""], ("x",)),
        ("times_s", [1, "2e0"], (1.0, 2.0)),
        ("files", ["a/b"], (Path("a/b"),)),
    ],
)
def test_a_value_in_range_is_taken_as_the_declared_type(name: str, given: Any, value: Any) -> None:
    taken = flatten(build(Outer, {name: given}, where="here"))[name]
    assert taken == value
    assert type(taken) is type(value)


@pytest.mark.parametrize(
    ("name", "given", "allowed"),
    [
        ("inner.share", 0, "a number above 0 and at most 1"),
        ("inner.share", 1.01, "a number above 0 and at most 1"),
        ("inner.share", "much", "a number above 0 and at most 1"),
        ("inner.width_m", -0.1, "a number of at least 0 and below 10 [m]"),
        ("inner.width_m", 10.0, "a number of at least 0 and below 10 [m]"),
        ("inner.width_m", math.nan, "a number of at least 0 and below 10 [m]"),
        ("inner.share", "1e-300", "a number above 0 and at most 1, of a size from 1e-12 to 1e+10"),
        ("inner.count", 0, "a whole number of at least 1"),
        ("inner.count", 2.0, "a whole number of at least 1"),
        ("inner.count", True, "a whole number of at least 1"),
        ("inner.on", 1, "true or false"),
        ("kind", "c", "one of a, b"),
        ("kind", 1, "one of a, b"),
        ("names", "x", "a list of texts"),
        ("names", [1], "a list of texts"),
        ("times_s", [math.inf], "a list of numbers [s]"),
        ("times_s", [10**400], "a list of numbers [s]"),
        ("files", [1], "a list of paths"),
    ],
)
def test_a_value_out_of_range_or_of_another_type_is_refused_with_what_is_allowed(
    name: str, given: Any, allowed: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        build(Outer, {name: given}, where="here")
    assert str(refused.value) == f"here: {name} = {given!r} is not allowed; use {allowed}"


def test_values_that_do_not_go_together_are_refused_whichever_comes_last() -> None:
    for before, change in (({"kind": "b"}, {"inner.on": True}), ({"inner.on": True}, {"kind": "b"})):
        with pytest.raises(ConfigError, match=r"there: kind = 'b' is not allowed; use a with inner\.on"):
            replaced(build(Outer, before, where="here"), change, where="there")


def test_the_differences_rebuild_a_configuration() -> None:
    config = Outer(kind="b", files=(Path("a"),), inner=Inner(share=0.1))
    assert differences(config) == {"kind": "b", "files": ["a"], "inner.share": 0.1}
    assert build(Outer, differences(config), where="here") == config
    assert differences(Outer()) == {}


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_setting_has_a_text_and_a_number_its_bound(cls: type) -> None:
    for name, described in all_settings(cls).items():
        assert described.text, name
        bounds = (described.above, described.at_least, described.below, described.at_most)
        assert (described.kind in (int, float)) == any(bound is not None for bound in bounds), name


WRONG = [
    (FrontendConfig, "min_depth_m", 900.0, "a depth below max_depth_m"),
    (BackendConfig, "max_landmarks", 119, "at least max_in_view"),
    (FusionConfig, "signing_key_file", "own.pem", "signing_key_file and peer_keys_folder together"),
    (FusionConfig, "max_packet_landmarks", 401, "at most 400"),
    (FusionConfig, "gate_probability", 1.0, "above 0 and below 1"),
    (StartConfig, "method", "magic", "one of given, static, in_flight, map"),
    (RigConfig, "rigid_sigma_deg", -1e-9, "at least 0"),
    (ImuConfig, "gravity", -9.8, "above 0"),
    (ImuConfig, "gyro_noise", 7.0, "at most 1"),
    (ImuConfig, "accel_noise", 60.0, "at most 5"),  # of a data sheet, in micro-g
    (ImuConfig, "gyro_bias_walk", 1e-12, "at least 1e-10"),
    (ImuConfig, "accel_bias_walk", 1e-10, "at least 1e-08"),
    (RigConfig, "focal_ratio_sigma", 10.0, "at most 0.1"),
    (RigConfig, "miscalibrated_sigma_px", 1e10, "at most 1000"),
    (BackendConfig, "sigma_px", 1e-4, "at least 0.01"),
    (BackendConfig, "track_sigma_px", 1e10, "at most 1000"),
    (BackendConfig, "gamma", 0.01, "at least 0.1"),
    (FusionConfig, "epoch_s", 1e-12, "at least 0.01"),  # rounded to 0 ns
    (ReplayConfig, "rate", -1.0, "at least 0"),
    (LinkConfig, "loss", 1.1, "at most 1"),
]


@pytest.mark.parametrize(("cls", "key", "value", "allowed"), WRONG, ids=lambda v: getattr(v, "__name__", str(v)))
def test_what_would_break_a_run_is_refused(cls: type, key: str, value: object, allowed: str) -> None:
    with pytest.raises(ConfigError, match=f"is not allowed; use .*{allowed}"):
        cls(**{key: value})
    with pytest.raises(ConfigError, match=f"is not allowed; use .*{allowed}"):
        dataclasses.replace(cls(), **{key: value})


def test_cameras_are_chosen_from_calibration_files() -> None:
    assert InputConfig(cameras=("cam1", "cam3"), calibration=(Path("camchain.yaml"),)).cameras == ("cam1", "cam3")
    with pytest.raises(ConfigError, match=r"cameras = \['cam1', 'cam3'\] is not allowed; use none where .*calibration"):
        InputConfig(cameras=("cam1", "cam3"))


@pytest.mark.parametrize("twice", [("world", "map"), ("map", "odom"), ("world", "odom")])
def test_no_frame_is_its_own_parent(twice: tuple[str, str]) -> None:
    assert OutputFramesConfig(world="a", map="b", odom="c").map == "b"
    with pytest.raises(ConfigError, match="'a' is not allowed; use a name for each frame"):
        OutputFramesConfig(**dict.fromkeys(twice, "a"))


def test_either_a_fleet_key_or_signing_keys() -> None:
    with pytest.raises(ConfigError, match="either a fleet key or signing keys"):
        FusionConfig(fleet_key_file="a", signing_key_file="b", peer_keys_folder="c")


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
