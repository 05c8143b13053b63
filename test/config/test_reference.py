# SPDX-License-Identifier: Apache-2.0
"""The reference page is what the code says."""

from pathlib import Path

from uav_vslam.config.nodes import NODES
from uav_vslam.config.reference import page
from uav_vslam.config.settings import all_settings
from uav_vslam.config.vehicle import VehicleConfig

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "parameters.md"


def test_the_page_in_docs_is_up_to_date() -> None:
    assert PAGE.read_text() == page(), "python -m uav_vslam.config.reference > docs/reference/parameters.md"


def test_every_parameter_is_on_the_page_and_declared_by_a_node() -> None:
    written = page()
    for name, described in all_settings(VehicleConfig).items():
        assert f"| `{name}` |" in written
        assert described.text in written
        assert any(name in node.used_names for node in NODES.values()), name
