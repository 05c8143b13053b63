# SPDX-License-Identifier: Apache-2.0
"""Progress of long work: a bar on a terminal, a line from time to time in a file or log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

LINE_EVERY_S = 60.0


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[..., None]]:
    """Show progress and yield the function that advances it by a count (default 1)."""
    if not sys.stdout.isatty():
        yield _lines(title, total)
        return
    from rich.progress import Progress

    with Progress(transient=True) as progress:
        yield partial(progress.advance, progress.add_task(title, total=total))


def _lines(title: str, total: int) -> Callable[..., None]:
    """Return a function that counts, and prints to standard error every `LINE_EVERY_S` seconds."""
    started_s = told_s = time.monotonic()
    done = 0

    def advance(count: int = 1) -> None:
        nonlocal done, told_s
        done += count
        now_s = time.monotonic()
        if now_s - told_s >= LINE_EVERY_S:
            told_s = now_s
            print(f"{title}: {done} of {total} after {(now_s - started_s) / 60:.0f} min", file=sys.stderr, flush=True)

    return advance
