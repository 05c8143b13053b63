# SPDX-License-Identifier: Apache-2.0
"""The quality of a mosaic of pictures as a table for the terminal, from its figures."""

from typing import Any

from rich.table import Table
from rich.text import Text

from uav_vslam.report.terminal import Terminal

Figures = dict[str, Any]


def print_mosaic(figures: Figures) -> None:
    """Print the figures of mosaic.json."""
    table = Table(show_header=False)
    table.add_column()
    table.add_column(justify="right")
    for name, value in rows(figures):
        table.add_row(Text(name), Text(value))
    Terminal().print(table)


def rows(figures: Figures) -> list[tuple[str, str]]:
    """Return the lines of the table."""
    unit = unit_of(figures["scale"])
    error, overlap, seam = figures["reprojection_px"], figures["overlap"], figures["seam"]
    return [
        ("Pictures used", f"{figures['used']} of {figures['pictures']}"),
        ("Matched pairs, points", f"{figures['pairs']}, {figures['points']}"),
        ("Reprojection error, RMS (median)", f"{error['rms']:.2f} px ({error['median']:.2f} px)"),
        *((f"Focal length of {name}", _focal(camera)) for name, camera in figures["cameras"].items()),
        ("Height above ground, median", f"{figures['height_m']:.1f} {unit}"),
        *([("Distance to GPS, median", f"{figures['gps']['median_m']:.1f} m")] if "gps" in figures else []),
        ("Ground sample distance", f"{figures['gsd_m']:.4f} {unit}"),
        ("Area, seen by two or more", f"{overlap['area_m2']:.0f} {unit}², {100 * overlap['share_twice']:.0f} %"),
        ("Pictures per place, mean", f"{overlap['mean_views']:.1f}"),
        ("Shift at seams, median (90 %)", _seam(seam)),
        ("Step of brightness at seams, median (90 %)", _step(seam)),
        ("Mosaic", f"{figures['width']}x{figures['height']} px of {figures['m_per_px']:.4g} {unit}"),
    ]


def unit_of(scale: str) -> str:
    """Return the unit of lengths of a mosaic, whose scale comes from GPS, the height, or nothing."""
    return "units" if scale == "none" else "m"


def _focal(camera: Figures) -> str:
    if camera["focal_sigma_px"] == 0.0:
        return f"{camera['focal_px']:.1f} px, given"
    return f"{camera['focal_px']:.1f} ± {camera['focal_sigma_px']:.1f} px"


def _seam(seam: Figures) -> str:
    if seam["median_px"] is None:
        return "no seams"
    return f"{seam['median_px']:.2f} px ({seam['p90_px']:.2f} px)"


def _step(seam: Figures) -> str:
    if seam["median_step"] is None:
        return "no seams"
    return f"{100 * seam['median_step']:.1f} % ({100 * seam['p90_step']:.1f} %)"
