# SPDX-License-Identifier: Apache-2.0
"""A flight's results as tables for the terminal."""

from rich.console import Console
from rich.table import Table

from uav_vslam.evaluation.clock_offset import ClockOffset
from uav_vslam.evaluation.scores import ATE_KEYS
from uav_vslam.evaluation.summary import TRACK_NAMES, TRACKS, Figures
from uav_vslam.report.layout import NEES_TITLES, RELATIVE_TITLES, ate_title, figure_text, new_table, print_table, wide
from uav_vslam.report.quality_lines import quality_lines

CLAIMS = {
    "1σ at\nend [m]": "sigma_end_m",
    "per 100 m\n[m]": "sigma_per_100m_m",
    "heading\n1σ [deg]": "sigma_heading_end_deg",
}


def print_summary(summary: Figures, console: Console | None = None) -> None:
    """Print the tables of a `build_summary` result, and lines about each vehicle's radio link and quality."""
    console = wide(console)
    console.print(_title(summary), style="bold", markup=False, highlight=False, soft_wrap=True)
    print_table(summary_table(summary), console)
    if is_scored(summary):
        print_table(relative_table(summary), console)
    for name, vehicle in summary["vehicles"].items():
        lines = quality_lines(vehicle)
        if offset := vehicle["clock_offset"]:
            lines.append(ClockOffset(**offset).text())
        for line in (link_line(name, vehicle, summary["mode"]), *(f"  {line}" for line in lines)):
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def is_scored(summary: Figures) -> bool:
    """Return whether there is ground truth."""
    return any(pooled["ate_m"] is not None for pooled in summary["pooled"].values() if pooled)


def summary_table(summary: Figures) -> Table:
    """Return rows per vehicle and track with errors, as far as there is ground truth, and what the estimate claims.

    Pooled rows come last, with ground truth only.
    """
    return _rows(summary, score_titles(summary["alignment"]) if is_scored(summary) else CLAIMS)


def score_titles(alignment: str) -> dict[str, str]:
    """Return the key of each column of scores, by its title."""
    aligned = {ate_title(name): key for name, key in ATE_KEYS.items() if name != alignment}
    errors = {"Height\n[m]": "height_rms_m", "End\n[m]": "end_m"}
    return {ate_title(alignment): "ate_m"} | aligned | errors | NEES_TITLES | {"1σ at\nend [m]": "sigma_end_m"}


def relative_table(summary: Figures) -> Table:
    """Return the rows of `summary_table` with the relative errors: root mean squares over segments of the path."""
    return _rows(summary, RELATIVE_TITLES)


def _rows(summary: Figures, columns: dict[str, str]) -> Table:
    table = new_table(("Vehicle", "Estimate"), columns)
    for name, tracks in figures_of(summary).items():
        for number, (track, figures) in enumerate(tracks.items(), 1):
            cells = [figure_text(figures.get(key)) for key in columns.values()]
            label = name if number == 1 else ""
            table.add_row(label, TRACK_NAMES[track], *cells, end_section=number == len(tracks))
    return table


def figures_of(summary: Figures) -> dict[str, dict[str, Figures]]:
    """Return the figures of each vehicle's tracks, and of several vehicles with ground truth also "pooled"."""
    found = dict(summary["vehicles"])
    if is_scored(summary) and len(found) > 1:
        found["pooled"] = summary["pooled"]
    return {
        name: {track: tracks[track] for track in TRACKS if tracks[track] is not None} for name, tracks in found.items()
    }


def link_line(name: str, vehicle: Figures, mode: str) -> str:
    """Return one line with distance, frames and, unless the flight's mode is none, radio statistics."""
    link = vehicle["link"]
    offered = "" if vehicle["frames_in"] is None else f" of {vehicle['frames_in']}"
    flown = f"{name}: {vehicle['distance_m']:.0f} m, {vehicle['frames_processed']}{offered} frames"
    if link["packets_sent"] == 0 and (vehicle["c_slam"] is None or mode == "none"):
        return f"{flown}; no peer"
    dropped = ", ".join(f"{count} {reason}" for reason, count in link["dropped"].items()) or "none"
    waiting = f", waiting {link['packets_waiting']}" if link.get("packets_waiting") else ""
    return (
        f"{flown}; sent {link['packets_sent']} packets, {link['sent_bytes_per_s'] / 1000:.2f} kB/s; "
        f"received {link['packets_received']}, used {link['packets_used']}{waiting}; dropped: {dropped}"
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
