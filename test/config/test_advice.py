# SPDX-License-Identifier: Apache-2.0
"""What is said about settings that decide nothing with the others, claim too much, or keep vehicles apart."""

import pytest

from uav_vslam.config import FleetConfig, idle_radio, load_vehicle, separate_maps
from uav_vslam.config.advice import idle_settings, overclaiming_settings
from uav_vslam.config.fleet import RadioConfig, ReplayConfig
from uav_vslam.config.settings import all_settings
from uav_vslam.config.vehicle import VehicleConfig

CHANGED = {"frontend.matcher": "gtm", "backend.association": "hgtm"}


def test_defaults_are_not_warned_about() -> None:
    assert idle_settings(VehicleConfig()) == {}
    assert overclaiming_settings(VehicleConfig()) == {}


@pytest.mark.parametrize("name", CHANGED)
def test_a_changed_method_that_klt_leaves_nothing_to_do_is_named_with_its_value_and_the_remedy(name: str) -> None:
    (found,) = idle_settings(load_vehicle(None, overrides={name: CHANGED[name]})).items()
    assert found[0] == name
    assert found[1].startswith(f"{name} = {CHANGED[name]} ")
    assert found[1].endswith("use frontend.method = sift")


def test_with_detection_in_every_pair_both_methods_decide() -> None:
    assert idle_settings(load_vehicle(None, overrides={**CHANGED, "frontend.method": "sift"})) == {}


def test_without_tracks_nothing_is_anchored() -> None:
    sift = load_vehicle(None, overrides={"frontend.method": "sift", "frontend.anchored": False})
    assert idle_settings(sift) == {
        "frontend.anchored": "frontend.anchored = False has no effect: only klt tracks points"
    }


@pytest.mark.parametrize(("name", "value"), [("backend.model", "euler9"), ("fusion.association", "coarse_fine")])
def test_a_baseline_that_claims_too_much_is_named_as_one(name: str, value: str) -> None:
    found = overclaiming_settings(load_vehicle(None, overrides={name: value}))
    assert list(found) == [name]
    assert found[name].startswith(f"{name} = {value} ")
    assert found[name].endswith("use it to compare, not to fly")


def test_who_does_not_cooperate_takes_no_pairs() -> None:
    alone = load_vehicle(None, overrides={"fusion.association": "nn", "fusion.mode": "none"})
    assert overclaiming_settings(alone) == {}


@pytest.mark.parametrize("name", CHANGED)
def test_the_reference_says_so_too(name: str) -> None:
    assert "klt" in all_settings(VehicleConfig)[name].text


@pytest.mark.parametrize(
    ("second", "apart"),
    [
        ({"start.method": "static"}, True),
        ({"start.method": "in_flight", "fusion.common_origin": False}, False),
        ({"start.method": "in_flight", "fusion.mode": "none"}, False),
        ({"start.method": "given"}, False),  # in the other's frame, say
        ({"start.method": "map"}, False),
    ],
)
def test_vehicles_of_which_each_defines_its_map_do_not_share_one(second: dict[str, object], apart: bool) -> None:
    first = load_vehicle(None, overrides={"start.method": "in_flight"})
    found = separate_maps({"uav1": first, "uav2": load_vehicle(None, overrides=second)})
    assert found.startswith("uav1, uav2 each start in a map frame of their own") == apart
    assert bool(found) == apart
    assert separate_maps({"uav1": first}) == ""


@pytest.mark.parametrize(("domain_id", "vehicles", "idle"), [(42, [], True), (42, ["uav1"], False), (-1, [], False)])
def test_a_radio_that_one_computer_does_not_use_is_said(domain_id: int, vehicles: list[str], idle: bool) -> None:
    both = {"uav1": VehicleConfig(), "uav2": VehicleConfig()}
    fleet = FleetConfig(both, ReplayConfig(), RadioConfig(domain_id=domain_id))
    assert idle_radio(fleet, vehicles).startswith("radio is not used") == idle
