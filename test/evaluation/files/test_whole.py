# SPDX-License-Identifier: Apache-2.0
"""A file is whole, or as it was before."""

from pathlib import Path

import pytest

from uav_vslam.evaluation.files.whole import whole


def test_a_file_is_there_when_it_is_complete(tmp_path: Path) -> None:
    with whole(tmp_path / "file") as partial:
        partial.write_text("new")
        assert not (tmp_path / "file").exists()
    assert (tmp_path / "file").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("failure", [KeyboardInterrupt, OSError])
def test_work_that_was_cut_short_leaves_what_was_there(failure: type[BaseException], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")

    def write_half() -> None:
        with whole(tmp_path / "file") as partial:
            partial.write_text("half")
            raise failure

    with pytest.raises(failure):
        write_half()
    assert (tmp_path / "file").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_file_behind_a_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "file").write_text("old")
    with whole(tmp_path / "link") as partial:
        partial.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "new"


def test_what_is_no_file_is_written_in_its_place() -> None:
    with whole(Path("/dev/null")) as partial:
        partial.write_text("anything")
    assert Path("/dev/null").is_char_device()
