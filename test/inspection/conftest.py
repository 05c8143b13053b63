# SPDX-License-Identifier: Apache-2.0
"""A small recorded flight of one vehicle with which nothing is wrong."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
from remembered import remembered_looks, remembered_sift

from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS


@pytest.fixture(scope="session")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clean") / "flight"
    record(dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=24, scale=0.25, seed=3), path)
    return path


@pytest.fixture(scope="module", autouse=True)
def _remembered() -> Iterator[None]:
    """Most faults leave the images of the clean flight as they are, and many their stamps and the rig, too."""
    with remembered_sift(), remembered_looks():
        yield
