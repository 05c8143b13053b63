# SPDX-License-Identifier: Apache-2.0
"""One command makes the key of a fleet, another says which vehicles have it; a fleet without one is told so once."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from uav_vslam.cli import main as command
from uav_vslam.config import FusionConfig, load_fleet
from uav_vslam.cooperation.authentication import FleetKey, authentication_for
from uav_vslam.cooperation.keys import new_key, without_key

FLEET = "vehicles: {uav1: , uav2: }\n"
Told = Callable[..., tuple[int, str]]


@pytest.fixture
def told(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Told:
    """Return what runs the command in an empty folder, and gives its exit code and all that it prints."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str]:
        code = command.main(["keys", *arguments])
        printed = capsys.readouterr()
        return code, printed.out + printed.err

    return run


def test_a_new_key_is_its_owners_and_opens_the_fleet(told: Told, tmp_path: Path) -> None:
    code, text = told("new", "fleet.key")
    assert code == 0
    key = tmp_path / "fleet.key"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert len(key.read_bytes()) == 32
    assert isinstance(authentication_for("uav1", FusionConfig(fleet_key_file=str(key))), FleetKey)
    (tmp_path / "fleet.yaml").write_text(FLEET + "fleet_key: fleet.key\n")
    fingerprint = text.split()[-1]
    code, text = told("check", "fleet.yaml")
    assert code == 0
    assert text == "".join(f"{name}: {key} {fingerprint}, good\n" for name in ("uav1", "uav2"))


def test_a_key_is_never_overwritten_and_never_repeated(told: Told, tmp_path: Path) -> None:
    told("new", "fleet.key")
    before = (tmp_path / "fleet.key").read_bytes()
    code, text = told("new", "fleet.key")
    assert code == 2
    assert "fleet.key exists" in text
    assert (tmp_path / "fleet.key").read_bytes() == before
    new_key(tmp_path / "other.key")
    assert (tmp_path / "other.key").read_bytes() != before


def vehicle_file(folder: Path, name: str, key: str) -> None:
    (folder / f"{name}.yaml").write_text(f"/**: {{ros__parameters: {{fusion: {{fleet_key_file: '{key}'}}}}}}\n")


def test_check_names_each_vehicle_whose_key_is_wrong(told: Told, tmp_path: Path) -> None:
    for name in ("one", "open", "other"):
        told("new", f"{name}.key")
    os.chmod(tmp_path / "open.key", 0o644)
    (tmp_path / "short.key").write_bytes(b"short")
    keys = {"uav1": "one", "uav2": "open", "uav3": "short", "uav4": "absent", "uav5": "other"}
    for name, key in keys.items():
        vehicle_file(tmp_path, name, str(tmp_path / f"{key}.key"))
    entries = ", ".join(f"{name}: {{config: {name}.yaml}}" for name in keys)
    (tmp_path / "fleet.yaml").write_text(f"vehicles: {{{entries}, uav6: }}\n")
    code, text = told("check", "fleet.yaml")
    assert code == 1
    lines = dict(line.split(": ", 1) for line in text.splitlines())
    assert "different keys" in lines["uav1"]
    assert "different keys" in lines["uav5"]
    assert "others may read it (mode 644)" in lines["uav2"]
    assert "a key of 5 bytes" in lines["uav3"]
    assert lines["uav3"].count("short.key") == 1
    assert "can't be read" in lines["uav4"]
    assert "no key" in lines["uav6"]
    code, text = told("check", "fleet.yaml", "--vehicle", "uav1")
    assert code == 0
    assert text.endswith("good\n")
    assert told("check", "fleet.yaml", "--vehicle", "uav9")[0] == 2


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (FLEET, ["uav1", "uav2"]),
        (FLEET + "mode: none\n", []),
        ("vehicles: {uav1: }\n", []),
        (FLEET + "fleet_key: fleet.key\n", []),
    ],
)
def test_only_a_fleet_that_cooperates_needs_a_key(tmp_path: Path, text: str, names: list[str]) -> None:
    (tmp_path / "fleet.yaml").write_text(text)
    assert without_key(load_fleet(tmp_path / "fleet.yaml")) == names
