# SPDX-License-Identifier: Apache-2.0
"""A bag or map is written into OUT.partial and moved to OUT when it is complete: OUT is whole or does not exist.

Work that was cut short starts again.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

from uav_vslam.errors import BagError

PARTIAL = ".partial"


def require_new(out: Path) -> list[str]:
    """Prepare for writing: remove what work that was cut short has left, and see whether a folder can be made.

    Returns:
        Warnings of what was removed.

    Raises:
        BagError: `out` exists, something else has its place, or nothing can be written there.
    """
    try:
        if out.exists():
            raise BagError(f"{out} exists already; remove it, or choose another name")
        partial = _partial(out)
        warnings = []
        if partial.exists():
            _remove(partial, out.name)
            warnings = [f"{partial}, left by work that was cut short, is removed"]
        partial.mkdir(parents=True)
        partial.rmdir()
    except OSError as error:
        raise BagError(f"{out}: can't be made ({error.strerror}); choose another place") from None
    return warnings


def require_place(folder: Path) -> None:
    """See whether a folder can be made, or written to where it is there already; nothing is left of the trial.

    Raises:
        BagError: it can't.
    """
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    try:
        with TemporaryFile(dir=there):  # permissions say nothing about read-only file systems
            pass
    except OSError as error:
        raise BagError(f"{folder}: can't be made ({there}: {error.strerror}); choose another place") from None


@contextmanager
def unfinished(out: Path) -> Iterator[Path]:
    """Yield the folder to make, which becomes `out` unless an exception is raised; that leaves nothing.

    Raises:
        BagError: see `require_new`.
    """
    require_new(out)
    partial = _partial(out)
    partial.mkdir()
    try:
        yield partial / out.name
        (partial / out.name).rename(out)
    finally:
        shutil.rmtree(partial)


def _remove(partial: Path, name: str) -> None:
    if not partial.is_dir() or {path.name for path in partial.iterdir()} - {name}:
        raise BagError(f"{partial} holds other things than unfinished work; remove or rename it")
    shutil.rmtree(partial)


def _partial(out: Path) -> Path:
    return out.with_name(out.name + PARTIAL)
