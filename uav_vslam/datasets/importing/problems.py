# SPDX-License-Identifier: Apache-2.0
"""What an import leaves out: nothing is lost without a word, and thousands of equal words are counted."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

SHOWN = 5  # of each kind at once; the others are counted


def _silent(_: str) -> None:
    """Drop the text."""


@dataclass(slots=True)
class Problems:
    """Collects what was left out.

    Attributes:
        tell: is given the first few of each kind at once.
        lines: all of them, "file:line: text".
        counts: how many of each kind.
    """

    tell: Callable[[str], None] = _silent
    lines: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, path: Path, text: str, *, line: int | None = None) -> None:
        """Note one.

        Args:
            kind: what it counts as, a plural noun ("missing pictures").
            path: file in which, or because of which, it was met.
            text: what is wrong.
            line: number in the file, from 1.
        """
        place = f"{path}:{line}" if line else str(path)
        self.lines.append(f"{place}: {text}")
        self.counts[kind] += 1
        if self.counts[kind] <= SHOWN:
            self.tell(self.lines[-1])
        if self.counts[kind] == SHOWN + 1:
            self.tell(f"more {kind} are counted only")

    def summary(self) -> str:
        """Return the counts in words, empty if there are none."""
        return ", ".join(f"{count} {kind}" for kind, count in self.counts.items())
