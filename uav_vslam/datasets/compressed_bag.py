# SPDX-License-Identifier: Apache-2.0
"""Bags whose storage files were compressed as a whole (`ros2 bag record --compression-mode file`): x.mcap.zstd.

They are unpacked into a folder for temporary files, which child processes share and the first process removes. Where
messages were compressed one by one, only metadata.yaml says so, which a recorder that was killed did not write.
"""

import atexit
import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import yaml
import zstandard

from uav_vslam.errors import BagError, one_line
from uav_vslam.yaml_text import parse_yaml

SUFFIX = ".zstd"
METADATA = "metadata.yaml"
MAGIC = b"\x28\xb5\x2f\xfd"  # of zstd's frames; CDR begins with zero
INFORMATION = "rosbag2_bagfile_information"
FOLDER = "UAV_VSLAM_UNPACKED"  # environment variable with the folder, for child processes
_given: dict[Path, Path] = {}  # what each folder's files were unpacked from


def compressed_files(path: Path) -> list[Path]:
    """Return the compressed files of a bag, a folder or one file; those that are also there unpacked do not count."""
    if path.is_dir():
        return sorted(p for p in path.iterdir() if p.suffix == SUFFIX and not p.with_suffix("").exists())
    return [path] if path.suffix == SUFFIX else []


@cache
def unpacked(path: Path) -> Path:
    """Return a copy of a bag with its files unpacked; it lasts as long as the process that first unpacked any.

    Args:
        path: bag folder or storage file, of which `compressed_files` finds some.

    Raises:
        BagError: a file or the metadata is damaged, or there is no room.
    """
    folder = _folder() / hashlib.sha256(bytes(path.resolve())).hexdigest()[:16]
    if not folder.exists():
        scratch = Path(tempfile.mkdtemp(dir=_folder()))
        packed = compressed_files(path)
        for file in packed:
            _unpack(file, scratch / file.stem)
        if path.is_dir():
            _link_the_rest(path, scratch, packed)
        with suppress(OSError):  # another process was first
            scratch.rename(folder)
    _given[folder] = path
    return folder if path.is_dir() else folder / path.stem


def unpacked_message(data: bytes) -> bytes:
    """Return the bytes of a message that was compressed alone; others, and those of a damaged one, as they are."""
    if not data.startswith(MAGIC):
        return data
    try:
        return zstandard.decompress(data)
    except zstandard.ZstdError:
        return data


def given_as(path: Path) -> Path:
    """Return the compressed bag of which a bag or file is the copy; others as they are."""
    return _given.get(path) or _given.get(path.parent) or path


def _folder() -> Path:
    """Return the folder of all copies, which the process that makes it removes."""
    if FOLDER not in os.environ:
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="uav_vslam_unpacked_")
        atexit.register(shutil.rmtree, os.environ[FOLDER], ignore_errors=True)
    return Path(os.environ[FOLDER])


def _unpack(file: Path, out: Path) -> None:
    try:
        with file.open("rb") as source, out.open("wb") as target:
            zstandard.ZstdDecompressor().copy_stream(source, target)
    except (OSError, zstandard.ZstdError) as error:
        raise BagError(f"{file} can't be unpacked into {out.parent} ({error}); unpack it yourself (zstd -d)") from None


def _link_the_rest(path: Path, folder: Path, packed: Sequence[Path]) -> None:
    """Complete an unpacked folder with links to the other files, and metadata that no longer mentions compression."""
    for other in path.iterdir():
        if other not in packed and other.name != METADATA:
            (folder / other.name).symlink_to(other.resolve())
    if (path / METADATA).exists():
        (folder / METADATA).write_text(_without_compression(path / METADATA), encoding="utf-8")


def _without_compression(metadata: Path) -> str:
    try:
        tree = parse_yaml(metadata.read_text(encoding="utf-8"))
        information = tree[INFORMATION]
        information |= {"compression_format": "", "compression_mode": ""}
        information["relative_file_paths"] = [name.removesuffix(SUFFIX) for name in information["relative_file_paths"]]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BagError(
            f"{metadata} is damaged ({one_line(error)}); correct it, or remove it: the files are then read without it"
        ) from None
    return yaml.safe_dump(tree)
