# SPDX-License-Identifier: Apache-2.0
"""What an import leaves out or repairs: nothing is lost silently, and thousands of equal messages are counted."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

# A loss of power leaves zeros at the end of a file, in thousands and on one line.
CONTROL, SHOWN_ENDS = re.compile(r"[\x00-\x1f\x7f]+"), 150
SHOWN = 5  # of each kind at once; the others are counted


@dataclass(slots=True)
class Problems:
    """Collects what was left out or repaired.

    Attributes:
        report: called with the first few of each kind at once.
        lines: all of them, "file:line: text".
        counts: how many of each kind were left out.
        repaired: how many of each kind are used all the same.
    """

    report: Callable[[str], None] = lambda _: None
    lines: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    repaired: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, path: Path, text: str, *, line: int | None = None, left_out: bool = True) -> None:
        """Note one.

        Args:
            kind: what it counts as, a plural noun ("missing or broken pictures").
            path: file in which, or because of which, it was met.
            text: what is wrong.
            line: number in the file, from 1.
            left_out: otherwise it is used all the same.
        """
        counts = self.counts if left_out else self.repaired
        place = f"{path}:{line}" if line else str(path)
        shown = CONTROL.sub("…", text)
        if len(shown) > 2 * SHOWN_ENDS:
            shown = f"{shown[:SHOWN_ENDS]}…{shown[-SHOWN_ENDS:]}"
        self.lines.append(f"{place}: {shown}")
        counts[kind] += 1
        if counts[kind] <= SHOWN:
            self.report(self.lines[-1])
        if counts[kind] == SHOWN + 1:
            self.report(f"more {kind} are counted only")

    def summary(self) -> str:
        """Return in words what was left out, empty if nothing was."""
        return _in_words(self.counts)

    def repaired_summary(self) -> str:
        """Return in words what is used all the same, empty if there is nothing."""
        return _in_words(self.repaired)


def _in_words(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())
