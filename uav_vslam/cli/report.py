# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam report`: one HTML page of a flight, of several side by side, of a study, or of a mosaic."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "write one HTML page of results, to be opened without a network"
EXAMPLES = """examples:
  uav-vslam report results/latest                        into results/latest/report.html
  uav-vslam report results/2026-01-31_120000_a results/2026-01-31_130000_b --output both.html    side by side
  uav-vslam report results/2026-01-31_140000_study_models                  a study
  uav-vslam report results/2026-01-31_150000_pictures_mosaic               a mosaic of plain pictures

run, map, demo, evaluate BAG, study and mosaic write the page themselves. It needs a browser alone: scripts, pictures
and data are inside.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="RESULT", help="folder of the results of a flight, a study or a mosaic"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="of the page (default: report.html in the first folder)"
    )


def run(args: argparse.Namespace) -> int:
    """Write the page and say where it is."""
    from uav_vslam.report.page.page import write_page

    print(f"page: {write_page(args.folders, args.output)}")
    return 0
