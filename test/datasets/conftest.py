# SPDX-License-Identifier: Apache-2.0
"""A small recorded flight of two vehicles."""

import dataclasses
from pathlib import Path

import pytest

from uav_vslam.simulation.recording import record
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
