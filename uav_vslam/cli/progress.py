# SPDX-License-Identifier: Apache-2.0
"""How far long work has come: a bar on a terminal, now and then a line where the output goes to a file or a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

LINE_EVERY_S = 60.0


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[..., None]]:
    """Show progress and give the function that moves it on, by one unless told by how many."""
    if not sys.stdout.isatty():
        yield _lines(title, total)
        return
    from rich.progress import Progress

    with Progress(transient=True) as progress:
        yield partial(progress.advance, progress.add_task(title, total=total))


def _lines(title: str, total: int) -> Callable[..., None]:
    """Return a function that counts, and tells standard error each time that `LINE_EVERY_S` have passed."""
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
