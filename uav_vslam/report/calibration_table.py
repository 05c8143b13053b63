# SPDX-License-Identifier: Apache-2.0
"""A stereo calibration as tables for the terminal, from its summary."""

import math

from rich.console import Console
from rich.table import Table
from rich.text import Text

from uav_vslam.calibration.summary import Figures
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.report.terminal import Terminal


def print_calibration(summary: Figures, console: Console | None = None) -> None:
    """Print the tables of a calibration's summary, and one line for each rejected pair and each warning."""
    console = console or Terminal()
    console.print(_title(summary), style="bold", markup=False, highlight=False, soft_wrap=True)
    console.print(camera_table(summary))
    console.print(half_table(summary))
    console.print(pair_table(summary))
    for pair in summary["rejected"]:
        console.print(f"rejected {pair['name']}: {pair['reason']}", markup=False, highlight=False, soft_wrap=True)


def camera_table(summary: Figures) -> Table:
    """Return the cameras' parameters with standard deviations, and what the images cover."""
    table = _table("Camera", "Left", "Right")
    names = [name for name in summary["cameras"]["left"]["parameters"] if name not in summary["fixed"]]
    for name in names:
        unit = " [px]" if name in ("fx", "fy", "cx", "cy") else ""
        digits = 2 if unit else 4
        table.add_row(Text(f"{name}{unit}"), *(_with_sigma(summary["cameras"][side], name, digits) for side in SIDES))
    covered = (f"{100 * summary['cameras'][side]['coverage']:.0f} %" for side in SIDES)
    table.add_row("Corners in image cells", *covered)
    table.add_row(Text("Reprojection [px]"), *(f"{summary['reprojection_px'][side]:.3f}" for side in SIDES))
    return table


def half_table(summary: Figures) -> Table:
    """Return what all pairs, the odd and the even ones give alone; "swapped" is the error with the other half's rig."""
    table = _table("Pairs", "RMS [px]", "Swapped", "Baseline [m]", "fx left", "fx right")
    whole, halves = summary["cameras"], summary["halves"]
    table.add_row(
        "all",
        f"{summary['reprojection_px']['stereo']:.3f}",
        "–",
        _rounded(summary["baseline_m"], summary["sigma_baseline_m"]),
        *(f"{whole[side]['parameters']['fx']:.2f}" for side in SIDES),
    )
    for k, name in enumerate(("odd", "even")):
        table.add_row(
            name,
            f"{halves['own_reprojection_px'][k]:.3f}",
            f"{halves['other_reprojection_px'][k]:.3f}",
            _rounded(halves["baseline_m"][k], halves["sigma_baseline_m"][k]),
            *(f"{focal:.2f}" for focal in halves["focal_px"][k]),
        )
    baseline, focal = (f"{100 * halves[key]:.2f} %" for key in ("baseline_difference", "focal_difference"))
    table.add_row("difference", "", "", baseline, focal, "", style="dim")
    return table


def pair_table(summary: Figures) -> Table:
    """Return the reprojection error of each pair [px]."""
    table = _table("Pair", "Left [px]", "Right [px]", "Stereo [px]")
    for pair in summary["pairs"]:
        table.add_row(Text(pair["name"]), *(f"{pair[key]:.3f}" for key in (*SIDES, "stereo")))
    return table


def _title(summary: Figures) -> str:
    board = summary["board"]
    width, height = summary["image_size"]
    return (
        f"{summary['name']}: board {board['columns']}x{board['rows']}, square {board['square_m']:g} m, "
        f"{width}x{height} px, {summary['model']}; {summary['pairs_used']} pairs used, "
        f"{len(summary['rejected'])} rejected; stereo reprojection {summary['reprojection_px']['stereo']:.3f} px"
    )


def _table(first: str, *others: str) -> Table:
    table = Table()
    table.add_column(Text(first))
    for heading in others:
        table.add_column(Text(heading), justify="right")  # in a str, [px] would be markup
    return table


def _rounded(value: float, sigma: float) -> str:
    """Return a value with two digits of its standard deviation."""
    digits = max(0, 1 - math.floor(math.log10(sigma))) if sigma > 0 else 4
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def _with_sigma(camera: Figures, name: str, digits: int) -> str:
    return f"{camera['parameters'][name]:.{digits}f} ± {camera['sigma'][name]:.{digits}f}"
