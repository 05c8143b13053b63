# SPDX-License-Identifier: Apache-2.0
"""What is said about settings that were changed but decide nothing with the others."""

import pytest

from uav_vslam.config import idle_settings, load_vehicle
from uav_vslam.config.settings import all_settings
from uav_vslam.config.vehicle import VehicleConfig

CHANGED = {"frontend.matcher": "gtm", "backend.association": "hgtm"}


def test_defaults_are_not_warned_about() -> None:
    assert idle_settings(VehicleConfig()) == {}


@pytest.mark.parametrize("name", CHANGED)
def test_a_changed_method_that_klt_leaves_nothing_to_do_is_named_with_its_value_and_the_remedy(name: str) -> None:
    (found,) = idle_settings(load_vehicle(None, overrides={name: CHANGED[name]})).items()
    assert found[0] == name
    assert found[1].startswith(f"{name} = {CHANGED[name]} ")
    assert found[1].endswith("use frontend.method = sift")


def test_with_detection_in_every_pair_both_methods_decide() -> None:
    assert idle_settings(load_vehicle(None, overrides={**CHANGED, "frontend.method": "sift"})) == {}


@pytest.mark.parametrize("name", CHANGED)
def test_the_reference_says_so_too(name: str) -> None:
    assert "klt" in all_settings(VehicleConfig)[name].text
