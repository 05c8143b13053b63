# SPDX-License-Identifier: Apache-2.0
"""A file is written beside its place and moved there when it is complete: it is whole or as it was before."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PARTIAL = ".partial"


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield the path to write to, which becomes `path` unless an exception is raised; that leaves nothing.

    What is no file (a terminal, a pipe), and a file in a folder that takes no others, is written in its place.
    """
    target = path.resolve()
    if target.exists() and not (target.is_file() and os.access(target.parent, os.W_OK)):
        yield path
        return
    partial = target.with_name(target.name + PARTIAL)
    try:
        yield partial
        partial.replace(target)
    except OSError as error:
        error.filename = str(path)  # that of a full disk knows no name
        raise
    finally:
        partial.unlink(missing_ok=True)
