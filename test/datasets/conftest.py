# SPDX-License-Identifier: Apache-2.0
"""A small recorded flight of two vehicles."""

import dataclasses
import os
from pathlib import Path

import pytest

from uav_vslam.cli.simulate import record
from uav_vslam.simulation.scenario import SCENARIOS, Scenario

TINY = dataclasses.replace(SCENARIOS["kagaru"], frames=6, scale=0.125, seed=3)


@pytest.fixture(scope="session")
def tiny() -> Scenario:
    return TINY


@pytest.fixture(scope="session")
def tiny_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "tiny"
    record(TINY, path)
    return path


@pytest.fixture(scope="session")
def euroc_mav0() -> Path:
    root = Path(__file__).resolve().parents[2]
    data = Path(os.environ.get("UAV_VSLAM_DATA", root.parent / "shared" / "data"))
    mav0 = data / "euroc_v101_keyframes" / "mav0"
    if not mav0.is_dir():
        pytest.skip(f"{mav0} is not there; set UAV_VSLAM_DATA to the folder of the shared recordings")
    return mav0
