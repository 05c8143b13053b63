# SPDX-License-Identifier: Apache-2.0
"""The committed scripts of the page are those that the sources and the lock of npm give."""

import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[3]
ASSETS = ROOT / "uav_vslam" / "report" / "page" / "assets"
PACKAGES = {"three": "MIT", "uplot": "MIT"}


@pytest.fixture(scope="module")
def recorder() -> ModuleType:
    """The program that records what the bundle was made of."""
    spec = importlib.util.spec_from_file_location("record_bundle", ROOT / "viewer" / "record_bundle.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_bundle_is_of_the_sources_and_the_lock(recorder: ModuleType) -> None:
    recorded = json.loads((ASSETS / "viewer.json").read_text())
    assert recorder.record() == recorded, "run scripts/bundle_viewer and commit what it writes"


def test_everything_bundled_is_locked_permissive_and_named() -> None:
    lock = json.loads((ROOT / "viewer" / "package-lock.json").read_text())["packages"]
    shipped = {
        name.rsplit("node_modules/", 1)[1]: entry for name, entry in lock.items() if name and not entry.get("dev")
    }
    assert {name: entry["license"] for name, entry in shipped.items()} == PACKAGES
    licences = (ASSETS / "viewer.licenses.txt").read_text()
    for name, entry in shipped.items():
        assert f"{name} {entry['version']}\n" in licences
        assert entry["integrity"].startswith("sha512-")
    assert licences.count("Permission is hereby granted, free of charge") == len(PACKAGES)


def test_each_script_names_its_licence_first_and_is_small() -> None:
    scripts = sorted((ROOT / "viewer" / "src").glob("*.js"))
    assert len(scripts) > 8
    for script in scripts:
        lines = script.read_text().splitlines()
        assert lines[0] == "// SPDX-License-Identifier: Apache-2.0", script.name
        assert len(lines) < 400, script.name


def test_the_bundle_can_stand_inside_a_page() -> None:
    bundle = (ASSETS / "viewer.js").read_text(encoding="ascii")
    assert not re.search(r"</script|<!--", bundle, re.IGNORECASE)
