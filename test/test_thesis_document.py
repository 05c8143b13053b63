# SPDX-License-Identifier: Apache-2.0
"""`docs/thesis.md` has a row for every figure, table and conclusion of the thesis, and its commands exist."""

import re
import shlex
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from uav_vslam.cli.main import build_parser

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "thesis.md"
VERDICTS = ("agrees", "differs", "not tested")
COUNTED_AS = ("agree", "differ", "are not tested")

# As the thesis's lists of figures and tables have them, chapters 3, 4, 6 and 7.
FIGURES = """
3.2.1 3.3.1 3.3.2 3.6.1 3.6.2 3.6.3 3.6.4 3.6.5 3.6.6 3.6.7 3.6.8 3.6.9 3.6.10 3.6.11 3.6.12 3.6.13 3.6.14 3.6.15
3.6.16a 3.6.16b 3.6.17a 3.6.17b 3.6.18a 3.6.18b 3.6.19a 3.6.19b
4.6.1 4.6.2 4.6.3 4.7.1
6.2.1 6.2.2 6.2.3 6.3.1 6.3.2 6.3.3 6.3.4 6.3.5 6.3.6 6.3.7a 6.3.7b 6.3.7c
6.4.1 6.4.1a 6.4.1b 6.4.2 6.4.2a 6.4.2b
7.3.1a 7.3.1b 7.3.1c 7.3.1d 7.3.2a 7.3.2b 7.3.2c 7.3.2d
7.4.1 7.4.1a 7.4.1b 7.4.1c 7.4.2a 7.4.2b 7.4.3a 7.4.3b 7.4.4a 7.4.4b 7.4.5a 7.4.5b
"""
TABLES = "3.6.1 3.6.2 3.6.3 3.6.4 4.7.1 4.7.2 7.4.1 7.4.2"
# How many conclusions the text of each section draws; the document numbers them.
CONCLUSIONS = """
3.1:2 3.2:1 3.3.1:2 3.3.2:3 3.4:1 3.4.1:1 3.4.2:1 3.4.3:3 3.4.4:1 3.4.5:3 3.5:2 3.6.2:6 3.6.3:17 3.6.4:12 3.6.5:11 3.7:9
4.1:9 4.2:1 4.3:1 4.3.3:4 4.4:3 4.4.1:1 4.5:1 4.5.1:4 4.6.1:1 4.6.2:2 4.6.3:1 4.7.2:5 4.7.3:5 4.8:14
6.1:3 6.2.4:2 6.3.4:1 6.3.5:5 6.3.6:3 6.4:2 6.4.1:2 6.4.2:3 6.5:4
7.1:7 7.2:4 7.3.1:1 7.3.2:6 7.4:1 7.4.1:3 7.4.2:3 7.4.3:2 7.4.4:5 7.5:5
8:8
"""
LABELS = [
    *(f"Fig. {number}" for number in FIGURES.split()),
    *(f"Table {number}" for number in TABLES.split()),
    *(
        f"{section} ({k})"
        for section, count in re.findall(r"([\d.]+):(\d+)", CONCLUSIONS)
        for k in range(1, int(count) + 1)
    ),
]


@dataclass(frozen=True, slots=True)
class DocumentRow:
    """A row of the document: which labels, what the thesis says, ours, the verdict, and the commands."""

    labels: list[str]
    thesis: str
    ours: str
    verdict: str
    commands: list[str]


def rows() -> list[DocumentRow]:
    found = []
    for line in DOCUMENT.read_text().splitlines():
        if not line.startswith("| ") or line.startswith("| ref |"):
            continue
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        assert len(cells) == 5, line
        labels, thesis, ours, verdict, command = cells
        found.append(DocumentRow(labels.split(", "), thesis, ours, verdict, re.findall(r"`([^`]+)`", command)))
    return found


def commands() -> list[str]:
    return sorted({command for row in rows() for command in row.commands})


def test_every_figure_table_and_conclusion_has_one_row() -> None:
    labels = Counter(label for row in rows() for label in row.labels)
    assert sorted(set(LABELS) - set(labels)) == []
    assert sorted(set(labels) - set(LABELS)) == []
    assert [label for label, count in labels.items() if count > 1] == []


def test_every_row_says_what_both_found_and_names_its_command() -> None:
    for row in rows():
        assert row.verdict in VERDICTS, row
        assert row.thesis, row
        assert row.ours, row
        assert row.commands or row.verdict == "not tested", row


def test_the_rows_are_counted_rightly() -> None:
    counts = Counter(row.verdict for row in rows())
    said = ", ".join(f"{counts[verdict]} {words}" for verdict, words in zip(VERDICTS, COUNTED_AS, strict=True))
    assert f"Of {len(rows())} rows {said}." in " ".join(DOCUMENT.read_text().split())


@pytest.mark.parametrize("command", commands())
def test_every_command_exists(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    words = shlex.split(command)
    if words[0] == "pytest":
        assert all(Path(word).exists() for word in words[1:] if not word.startswith("-"))
    else:
        build_parser(words).parse_args(words)
