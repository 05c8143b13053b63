# SPDX-License-Identifier: Apache-2.0
"""The file of a saved map: a compressed npz of plain arrays, one of which is a header in JSON; docs/maps.md.

It holds no Python objects, so loading runs no code of the file's.
"""

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import MapError
from uav_vslam.geometry.coded_points import pack_lower, unpack_lower
from uav_vslam.slam.saved_map.record import MapOrigin, MapSection, SavedMap
from uav_vslam.slam.state_folder import replace_file

FORMAT, VERSION = "uav_vslam map", 1
MAX_LANDMARKS = 5_000_000  # a file with more is refused before its arrays are used
COLUMNS: dict[str, tuple[str, int]] = {  # kind and numbers of a row; 0: one number, -1: any
    "section": ("u4", 0),
    "ids": ("u4", 0),
    "positions": ("f8", 3),
    "own_factors": ("f8", 6),
    "descriptors": ("u1", -1),
    "observations": ("u4", 0),
}
SECTION_COLUMNS: dict[str, tuple[str, int]] = {"anchors": ("f8", 3), "common_factors": ("f8", 21)}

Arrays = dict[str, Any]  # of arrays; Any suits savez, which also has named options


def save_map(saved: SavedMap, file: Path | str) -> int:
    """Write a map, replacing one of that name as a whole, and return its size [byte].

    Raises:
        MapError: the file can't be written, or is there and no map.
    """
    path, content = Path(file), io.BytesIO()
    try:
        _check_replaceable(path)
        np.savez_compressed(content, header=np.array(_header(saved)), **_columns(saved))
        replace_file(path, content.getvalue(), durable=False)
    except (OSError, ValueError) as error:  # the latter of a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise MapError(
            f"{path}: the map can't be written ({reason}); name a file in a folder that is writable"
        ) from None
    return content.getbuffer().nbytes


def _check_replaceable(path: Path) -> None:
    """Refuse to replace what is no map; a folder can't be replaced.

    Raises:
        MapError: the file is there and no map.
        OSError, ValueError: there can't be such a file, or nobody may look.
    """
    is_map = path.is_file() and (path.stat().st_size == 0 or _holds_header(path))
    if path.exists() and not (is_map or path.is_dir()):
        raise MapError(f"{path} is no map, and is not replaced; name another file")


def _holds_header(path: Path) -> bool:
    """Return whether a file is an archive of arrays with a map's header: other archives are somebody's data."""
    try:
        with zipfile.ZipFile(path) as archive:
            if "header.npy" not in archive.namelist():
                return False
        with np.load(path, allow_pickle=False) as content:
            return bool(json.loads(str(content["header"]))["format"] == FORMAT)
    except (OSError, KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return False


def load_map(file: Path | str) -> SavedMap:
    """Read a map.

    Raises:
        MapError: the file is missing, damaged, of another version, or no map.
    """
    path = Path(file)
    try:
        with path.open("rb") as raw:
            if not zipfile.is_zipfile(raw):  # numpy would take it for pickled objects
                raise ValueError("it is not a whole file as save_map writes it")
            raw.seek(0)
            with np.load(raw, allow_pickle=False) as content:
                header = json.loads(str(content["header"]))
                _check_header(header)
                arrays = {name: np.asarray(content[name]) for name in (*COLUMNS, *SECTION_COLUMNS)}
        _check_arrays(arrays)
        saved = SavedMap(_origin(header), _sections(arrays))
    except OSError as error:
        raise MapError(f"{path}: the map can't be read ({error.strerror or error})") from None
    except (KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise MapError(f"{path} is no map, or it is damaged ({error}); save it again, or copy it again") from None
    if saved.hash != header["hash"]:
        raise MapError(f"{path} is damaged: its content has hash {saved.hash}, the header {header['hash']}")
    return saved


def _header(saved: SavedMap) -> str:
    origin = saved.origin
    return json.dumps(
        {
            "format": FORMAT,
            "version": VERSION,
            "hash": saved.hash,
            "vehicle": origin.vehicle,
            "session": origin.session,
            "frame": origin.frame,
            "stamp_ns": origin.stamp_ns,
            "other_sources": origin.other_sources,
            "datum": origin.datum,
            "landmarks": len(saved),
            "sections": len(saved.sections),
        }
    )


def _check_header(header: Any) -> None:
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']!r} instead of {FORMAT!r}")
    if header["version"] != VERSION:
        raise ValueError(f"version {header['version']}; this program reads version {VERSION}")
    if not (isinstance(header["vehicle"], str) and isinstance(header["frame"], str)):
        raise ValueError("vehicle and frame are no texts")


def _origin(header: dict[str, Any]) -> MapOrigin:
    datum = header["datum"]
    return MapOrigin(
        vehicle=header["vehicle"],
        session=int(header["session"]),
        frame=header["frame"],
        stamp_ns=int(header["stamp_ns"]),
        other_sources=tuple(str(source) for source in header["other_sources"]),
        datum=None if datum is None else (float(datum[0]), float(datum[1]), float(datum[2])),
    )


def _columns(saved: SavedMap) -> Arrays:
    sections, size = saved.sections, saved.descriptor_size
    counts = [len(section) for section in sections]
    shapes = {name: () if width == 0 else (size if width < 0 else width,) for name, (_, width) in COLUMNS.items()}
    empty = {name: np.zeros((0, *shapes[name]), kind) for name, (kind, _) in COLUMNS.items()}
    rows: dict[str, list[NDArray[Any]]] = {
        "section": [np.repeat(np.arange(len(counts), dtype=np.uint32), counts)],
        "ids": [section.ids for section in sections],
        "positions": [section.positions for section in sections],
        "own_factors": [pack_lower(section.own_factors) for section in sections],
        "descriptors": [section.descriptors for section in sections],
        "observations": [section.observations for section in sections],
    }
    of_sections = {
        "anchors": np.array([section.anchor for section in sections]).reshape(-1, 3),
        "common_factors": np.array([pack_lower(section.common_factor) for section in sections]).reshape(-1, 21),
    }
    return {name: np.concatenate([empty[name], *parts]) for name, parts in rows.items()} | of_sections


def _check_arrays(arrays: Arrays) -> None:
    """Check kinds, shapes and numbers; raises ValueError."""
    count, sections = len(arrays["ids"]), len(arrays["anchors"])
    if count > MAX_LANDMARKS:
        raise ValueError(f"{count} landmarks; at most {MAX_LANDMARKS} are read")
    for names, rows in ((COLUMNS, count), (SECTION_COLUMNS, sections)):
        for name, (kind, width) in names.items():
            array = arrays[name]
            shape = (rows, *array.shape[1:]) if width < 0 else (rows, width) if width else (rows,)
            if array.dtype.str[1:] != kind or array.shape != shape or (width < 0 and array.ndim != 2):
                raise ValueError(f"{name} is {array.dtype} of shape {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name} holds NaN or infinity")
    if count and (np.diff(arrays["section"].astype(int)) < 0).any() | (arrays["section"].max() >= sections):
        raise ValueError("landmarks are not in the order of the sections")
    if not (arrays["own_factors"][:, [0, 2, 5]] > 0).all():
        raise ValueError("the covariance of a landmark is not positive definite")


def _sections(arrays: Arrays) -> tuple[MapSection, ...]:
    ends = np.searchsorted(arrays["section"], np.arange(1, len(arrays["anchors"])))
    parts = {name: np.split(arrays[name], ends) for name in COLUMNS}
    common = unpack_lower(arrays["common_factors"])
    return tuple(
        MapSection(
            anchor=arrays["anchors"][k],
            common_factor=common[k],
            ids=parts["ids"][k],
            positions=parts["positions"][k],
            own_factors=unpack_lower(parts["own_factors"][k]),
            descriptors=parts["descriptors"][k],
            observations=parts["observations"][k],
        )
        for k in range(len(arrays["anchors"]))
    )
