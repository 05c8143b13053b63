# SPDX-License-Identifier: Apache-2.0
"""A saved map is read back to the bit, and nothing else is taken for one."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.errors import MapError
from uav_vslam.slam.saved_map import MapOrigin, SavedMap, load_map, save_map


@pytest.fixture
def path(saved: SavedMap, tmp_path: Path) -> Path:
    """Return the file of a map."""
    save_map(saved, tmp_path / "uav1_map.npz")
    return tmp_path / "uav1_map.npz"


def test_a_map_is_read_as_it_was_written(saved: SavedMap, path: Path) -> None:
    read = load_map(path)
    assert read.origin == saved.origin
    assert [len(section) for section in read.sections] == [len(section) for section in saved.sections]
    assert read.hash == saved.hash
    np.testing.assert_array_equal(read.sections[0].covariance, saved.sections[0].covariance)


def test_the_same_map_makes_the_same_bytes(saved: SavedMap, path: Path) -> None:
    before = path.read_bytes()
    assert save_map(saved, path) == len(before)
    assert path.read_bytes() == before


def test_an_empty_map_can_be_kept(tmp_path: Path) -> None:
    save_map(SavedMap(MapOrigin("uav1", 1, frame="uav1/map", stamp_ns=0)), tmp_path / "empty.npz")
    assert len(load_map(tmp_path / "empty.npz")) == 0


def rewritten(path: Path, **changes: object) -> None:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    header = json.loads(str(arrays["header"]))
    for name, value in changes.items():
        if name in header:
            header[name] = value
        else:
            arrays[name] = value(arrays[name]) if callable(value) else value
    np.savez(path, **(arrays | {"header": np.array(json.dumps(header))}))


def nan_in(array: np.ndarray) -> np.ndarray:
    return np.where(np.arange(array.size).reshape(array.shape) == 5, np.nan, array)


DAMAGES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "cut short": ("no map, or it is damaged", lambda p: p.write_bytes(p.read_bytes()[: p.stat().st_size // 2])),
    "empty file": ("no map, or it is damaged", lambda p: p.write_bytes(b"")),
    "another file": ("not a whole file as save_map writes it", lambda p: p.write_text("stamp,x,y,z\n")),
    "missing": ("can't be read", lambda p: p.unlink()),
    "a newer version": ("version 2; this program reads version 1", lambda p: rewritten(p, version=2)),
    "another format": ("format 'grid'", lambda p: rewritten(p, format="grid")),
    "not a number": ("NaN", lambda p: rewritten(p, positions=nan_in)),
    "a moved landmark": ("is damaged: its content has hash", lambda p: rewritten(p, positions=lambda a: a + 1e-9)),
    "a landmark too many": ("shape", lambda p: rewritten(p, ids=lambda a: a[:-1])),
    "another section": ("order of the sections", lambda p: rewritten(p, section=lambda a: a[::-1])),
    "no covariance": ("not positive definite", lambda p: rewritten(p, own_factors=lambda a: 0.0 * a)),
    "objects": ("no map, or it is damaged", lambda p: rewritten(p, ids=np.array([print] * 3, object))),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_file_that_is_no_sound_map_is_refused_with_the_reason(path: Path, damage: str) -> None:
    reason, harm = DAMAGES[damage]
    harm(path)
    with pytest.raises(MapError, match=reason) as error:
        load_map(path)
    assert str(path) in str(error.value)


def test_a_folder_that_is_not_there_is_named(saved: SavedMap, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="can't be written"):
        save_map(saved, tmp_path / "nowhere" / "map.npz")


@pytest.mark.parametrize("name", ["/", "x" * 300, "a\0b"])
def test_a_name_that_no_map_can_have_is_refused(saved: SavedMap, tmp_path: Path, name: str) -> None:
    with pytest.raises(MapError, match="can't be written"):
        save_map(saved, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_may_not_be_looked_into_is_refused(saved: SavedMap, tmp_path: Path) -> None:
    user, closed = os.geteuid(), tmp_path / "closed"
    closed.mkdir(mode=0)
    if user == 0:  # who may look everywhere
        os.seteuid(65534)
    try:
        with pytest.raises(MapError, match="Permission denied"):
            save_map(saved, closed / "map.npz")
    finally:
        os.seteuid(user)


def test_a_file_that_is_no_map_is_not_replaced(saved: SavedMap, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(MapError, match="is no map, and is not replaced"):
        save_map(saved, tmp_path / "notes.txt")
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("header", [None, "mine", "{}", '{"format": "my flight"}', 3.0])
def test_arrays_of_somebody_else_are_not_replaced(saved: SavedMap, tmp_path: Path, header: str | float | None) -> None:
    """An archive as NumPy writes it, but no map."""
    path = tmp_path / "flight.npz"
    np.savez(path, positions=np.ones(3), **({} if header is None else {"header": np.array(header)}))
    with pytest.raises(MapError, match="is no map, and is not replaced"):
        save_map(saved, path)
    assert np.load(path)["positions"].tolist() == [1.0, 1.0, 1.0]


def test_a_map_that_cannot_be_put_in_its_place_leaves_nothing_behind(saved: SavedMap, tmp_path: Path) -> None:
    (tmp_path / "map.npz" / "in the way").mkdir(parents=True)
    with pytest.raises(MapError, match="can't be written"):
        save_map(saved, tmp_path / "map.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]
