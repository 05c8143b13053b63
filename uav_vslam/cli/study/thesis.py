# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study thesis`: the thesis's own cooperative simulation."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_run_arguments, publish, seeds_of

HELP = "the thesis's cooperative simulation (7.3.2) with its three ways to communicate; tables and its figures"
EXAMPLES = """examples:
  uav-vslam study thesis                   20 seeds, 6 and 10 px; about half an hour
  uav-vslam study thesis --seeds 2         a first look; minutes
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    add_run_arguments(parser, seeds=20)
    parser.add_argument("--frames", type=int, default=360, help="steps of a run (default 360)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables, write them and the figures of the first seed."""
    from uav_vslam.report.error_plot import error_plot
    from uav_vslam.report.style import save
    from uav_vslam.report.views import view_3d
    from uav_vslam.studies.fusion import compute as fusion
    from uav_vslam.studies.fusion.plot import draw_fusion
    from uav_vslam.studies.thesis import compute as thesis
    from uav_vslam.studies.thesis.ellipsoid_plot import ellipsoid_plot

    parts, seeds = thesis.modes(args.frames), seeds_of(args)

    def draw(tree: dict[str, Any], folder: Path) -> list[Path]:
        drawn = draw_fusion(tree, folder)
        for part in parts:
            result = thesis.example(part, seeds[0])
            for name, plot in (("trajectory", view_3d), ("errors", error_plot), ("covariance", ellipsoid_plot)):
                figure = plot(result)
                if figure is not None:
                    drawn.append(save(figure, folder / f"{part.table.replace(' ', '_')}_{name}.png"))
        return drawn

    with progress_bar("study thesis", len(parts) * len(seeds)) as advance:
        rows = fusion.run_parts(parts, seeds, workers=args.workers, on_job=advance)
    return publish("thesis", rows, seeds, args.results, notes=fusion.NOTES | thesis.NOTES, plot=draw)
