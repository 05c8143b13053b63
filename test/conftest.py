# SPDX-License-Identifier: Apache-2.0
"""What the tests share: the recordings outside the repository, and repeatable property tests."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples every time, no file beside the code, and no deadline: a busy host is no failure.
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")

ROOT = Path(__file__).parents[1]


def _data_root() -> Path:
    return Path(os.environ.get("UAV_VSLAM_DATA", ROOT / "../shared/data")).resolve()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs recordings where there are none: they are too large to be part of the repository."""
    if _data_root().is_dir():
        return
    skip = pytest.mark.skip(reason="UAV_VSLAM_DATA names no folder with the shared recordings")
    for item in items:
        if item.get_closest_marker("data"):
            item.add_marker(skip)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the shared recordings; a test that uses it carries the marker `data`."""
    return _data_root()
