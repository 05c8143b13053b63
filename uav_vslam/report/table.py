# SPDX-License-Identifier: Apache-2.0
"""A flight's results as a table for the terminal."""

from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from uav_vslam.evaluation.summary import TRACKS, Figures
from uav_vslam.report.quality_lines import quality_lines

NAMES = {"ins": "INS", "s_slam": "S-SLAM", "c_slam": "C-SLAM"}
ERRORS = {"ATE [m]": "ate_m", "End [m]": "end_m", "Position NEES": "nees_position"}
CLAIMS = {
    "1σ at end [m]": "sigma_end_m",
    "per 100 m [m]": "sigma_per_100m_m",
    "Heading 1σ [deg]": "sigma_heading_end_deg",
}
ABSENT = "–"


def print_summary(summary: Figures, console: Console | None = None) -> None:
    """Print the table of a `build_summary` result, and lines about each vehicle's radio link and quality."""
    console = console or Console()
    console.print(_title(summary), style="bold", markup=False, highlight=False, soft_wrap=True)
    console.print(summary_table(summary))
    for name, vehicle in summary["vehicles"].items():
        for line in (link_line(name, vehicle), *(f"  {line}" for line in quality_lines(vehicle))):
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def summary_table(summary: Figures) -> Table:
    """Return rows per vehicle and track with errors, as far as there is ground truth, and what the estimate claims.

    Pooled rows come last, with ground truth only.
    """
    scored = any(summary["pooled"][track]["ate_m"] is not None for track in TRACKS if summary["pooled"][track])
    columns = {**ERRORS, "1σ at end [m]": CLAIMS["1σ at end [m]"]} if scored else CLAIMS
    table = Table()
    table.add_column("Vehicle")
    table.add_column("Estimate")
    for heading in columns:
        table.add_column(Text(heading), justify="right")  # in a str, [m] would be markup
    rows = dict(summary["vehicles"])
    if scored and len(rows) > 1:
        rows["pooled"] = summary["pooled"]
    for name, tracks in rows.items():
        present = [track for track in TRACKS if tracks[track] is not None]
        for track in present:
            figures = tracks[track]
            cells = [figure_text(figures.get(key)) for key in columns.values()]
            first, last = track == present[0], track == present[-1]
            table.add_row(name if first else "", NAMES[track], *cells, end_section=last)
    return table


def link_line(name: str, vehicle: Figures) -> str:
    """Return one line with distance, frames and radio statistics."""
    link = vehicle["link"]
    offered = "" if vehicle["frames_in"] is None else f" of {vehicle['frames_in']}"
    flown = f"{name}: {vehicle['distance_m']:.0f} m, {vehicle['frames_processed']}{offered} frames"
    if vehicle["c_slam"] is None and link["packets_sent"] == 0:
        return f"{flown}; no peer"
    dropped = ", ".join(f"{count} {reason}" for reason, count in link["dropped"].items()) or "none"
    return (
        f"{flown}; sent {link['packets_sent']} packets, {link['sent_bytes_per_s'] / 1000:.2f} kB/s; "
        f"received {link['packets_received']}, used {link['packets_used']}; dropped: {dropped}"
    )


def _title(summary: Figures) -> str:
    parts = [summary["name"], f"mode {summary['mode']}"]
    if summary["seed"] is not None:
        parts.append(f"seed {summary['seed']}")
    parts.append(f"{summary['duration_s']:.1f} s of flight")
    if summary["realtime_factor"] is not None:
        parts.append(f"{summary['realtime_factor']:.2f}x real time")
    if summary["alignment"] != "none":
        parts.append(f"aligned ({summary['alignment']})")
    return ", ".join(parts)


def figure_text(value: Any) -> str:
    """Return a number with three decimals, or one from 10 on; a dash for None."""
    if value is None:
        return ABSENT
    return f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"
