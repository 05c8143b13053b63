# SPDX-License-Identifier: Apache-2.0
"""The record of a study, from which the command line makes its arguments, runs it and publishes its findings.

Nothing heavy is imported here: `uav-vslam study --help` reads the record of every study.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from uav_vslam.evaluation.study import Row
from uav_vslam.studies.engine.columns import check_rows


class Progress(Protocol):
    """Starts a progress bar, in place of the one before, and returns the function that advances it."""

    def __call__(self, total: int, title: str = ...) -> Callable[..., None]: ...


@dataclass(frozen=True, slots=True)
class Findings:
    """Results of a study.

    Attributes:
        rows: of `study.json`; those with different values of "table" form different tables. `columns` has their
            keys.
        notes: what the figures mean, by subject.
        series: curves for plots, one dict each, with lists of equal length.
        draw: draws the content of `study.json` into a folder.
    """

    rows: list[Row]
    notes: Mapping[str, str] = field(default_factory=dict)
    series: list[Row] | None = None
    draw: Callable[[dict[str, Any], Path], list[Path]] | None = None

    def __post_init__(self) -> None:
        check_rows(self.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """One study, as the command line knows it.

    Attributes:
        help: what it compares.
        takes: how long by default.
        examples: of the command line, and further explanation.
        run: runs it; given the arguments, the seeds and the progress display.
        add_arguments: declares the study's own arguments.
        seeds: how many by default.
        seedless: it may be run without any, on recordings alone.
        workers: processes by default; 0 for a study that is one process at a time.
        frames: of each flight by default; 0 where the study has no such argument.
        scaled: `--scale` changes the size of the images.
        variants: which settings are compared where `--variant` names none; empty where the study has no such argument.
            `args.variant` holds their overrides by name.
        settings: `--set KEY=VALUE` changes the configuration. `args.set` holds the overrides.
    """

    help: str
    takes: str
    examples: str
    run: Callable[[argparse.Namespace, list[int], Progress], Findings]
    add_arguments: Callable[[argparse.ArgumentParser], None] = lambda parser: None
    seeds: int = 20
    seedless: bool = False
    workers: int = 2
    frames: int = 0
    scaled: bool = False
    variants: str = ""
    settings: bool = False
