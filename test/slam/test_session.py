# SPDX-License-Identifier: Apache-2.0
"""The session number increases with every start, whatever happens to clock and file."""

from pathlib import Path

import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.slam.session import next_session, state_folder


def test_the_first_session_is_the_clocks_second(tmp_path: Path) -> None:
    assert next_session("uav1", folder=tmp_path / "new" / "folder", now_s=1_700_000_000.9) == 1_700_000_000
    assert (tmp_path / "new" / "folder" / "uav1.session").read_text() == "1700000000\n"


@pytest.mark.parametrize(("now_s", "expected"), [(5000, 5000), (1000, 1001), (0, 1001), (1001, 1001)])
def test_a_later_one_is_larger_though_the_clock_stands_or_steps_back(tmp_path: Path, now_s, expected) -> None:
    next_session("uav1", folder=tmp_path, now_s=1000)
    assert next_session("uav1", folder=tmp_path, now_s=now_s) == expected
    assert next_session("uav1", folder=tmp_path, now_s=now_s) == expected + 1


def test_vehicles_on_one_host_count_apart(tmp_path: Path) -> None:
    next_session("uav1", folder=tmp_path, now_s=1000)
    assert next_session("uav2", folder=tmp_path, now_s=10) == 10


@pytest.mark.parametrize("content", [b"", b"twelve", b"\xff\xfe"])
def test_with_a_damaged_file_the_clock_counts(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "uav1.session").write_bytes(content)
    assert next_session("uav1", folder=tmp_path, now_s=77) == 77
    assert next_session("uav1", folder=tmp_path, now_s=77) == 78


def test_no_temporary_file_remains(tmp_path: Path) -> None:
    next_session("uav1", folder=tmp_path, now_s=1)
    assert [path.name for path in tmp_path.iterdir()] == ["uav1.session"]


def test_an_unwritable_folder_is_reported_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="XDG_STATE_HOME"):
        next_session("uav1", folder=tmp_path / "file", now_s=1)


def test_the_folder_is_where_the_user_keeps_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "uav_vslam"
    assert next_session("uav1") >= 1_700_000_000
    assert (tmp_path / "uav_vslam" / "uav1.session").exists()
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert state_folder() == tmp_path / "home" / ".local" / "state" / "uav_vslam"
