# SPDX-License-Identifier: Apache-2.0
"""Draws the fusion study: gain and consistency of each setting, and the cost of a larger fleet."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uav_vslam.evaluation.study import TABLE, Row, tables_of
from uav_vslam.report.style import LINE_COLOURS, clean, plain_log, save

FLEET = " vehicles"  # how the headings of the fleets' tables end


def draw_fusion(tree: dict[str, Any], folder: Path) -> list[Path]:
    """Draw what the study holds into its folder and return the paths."""
    tables = tables_of(tree)
    fleets = [row for row in tree["rows"] if row[TABLE].endswith(FLEET)]
    named = {heading: rows for heading, rows in tables.items() if not heading.endswith(FLEET)}
    drawn = [save(gain_plot(h, rows), folder / f"{h.replace(' ', '_')}.png") for h, rows in named.items()]
    return drawn + ([save(fleet_plot(fleets), folder / "fleets.png")] if len(fleets) > 1 else [])


def gain_plot(heading: str, rows: list[Row]) -> Figure:
    """Return error against the vehicles alone and NEES, with their intervals, a line for each setting."""
    figure = Figure(figsize=(11.0, 1.6 + 0.34 * len(rows)), layout="constrained")
    figure.suptitle(heading[:1].upper() + heading[1:], x=0.01, ha="left")
    gain, nees = figure.subplots(1, 2, sharey=True)
    for line, row in enumerate(rows):
        if row["ratio_to_s_slam"] is None:
            gain.text(1.0, line, f" {row['failures']} of {row['runs']} runs failed", va="center", color="#a02020")
            continue
        low, high = (row.get(f"ratio_{end}") or row["ratio_to_s_slam"] for end in ("low", "high"))
        gain.plot([low, high], [line, line], color=LINE_COLOURS[0], linewidth=2.2)
        gain.plot(row["ratio_to_s_slam"], line, "o", color=LINE_COLOURS[0])
        if row["nees_position"] is not None:
            ends = [row.get(f"nees_position_{end}") or row["nees_position"] for end in ("low", "high")]
            colour = LINE_COLOURS[0] if ends[0] <= 1.0 else LINE_COLOURS[1]
            nees.plot(ends, [line, line], color=colour, linewidth=2.2)
            nees.plot(row["nees_position"], line, "o", color=colour)
            nees.plot(row["nees_position_worst_quarter"], line, "|", color=colour)
        if row["failures"]:
            gain.text(high, line, f"  {row['failures']} of {row['runs']} failed", va="center", color="#a02020")
    gain.axvline(1.0, color="#888888", linewidth=0.8, linestyle=":")
    nees.axvline(1.0, color="#888888", linewidth=0.8, linestyle=":")
    gain.set_yticks(range(len(rows)), [row["method"] for row in rows])
    gain.set(xlabel="ATE with peers / ATE alone", ylim=(len(rows) - 0.5, -0.5))
    nees.set(xlabel="Position NEES / 3 (tick: worst quarter of the flight)")
    plain_log(nees, "x")
    for axes in (gain, nees):
        clean(axes)
    return figure


def fleet_plot(rows: list[Row]) -> Figure:
    """Return error, bytes and time over the number of peers; flights too short for a figure leave a gap."""
    peers = [int(row[TABLE].removesuffix(FLEET)) - 1 for row in rows]
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    what = (
        ("ratio_to_s_slam", 1.0, "ATE with peers / ATE alone"),
        ("sent_bytes_per_s", 1e-3, "Payload sent by a vehicle [kB/s]"),
        ("ms_per_epoch", 1.0, "Fusion and packet, an epoch [ms]"),
    )
    for axes, (key, scale, label) in zip(figure.subplots(1, 3), what, strict=True):
        values = [np.nan if row[key] is None else scale * row[key] for row in rows]
        axes.plot(peers, values, "o-", color=LINE_COLOURS[0])
        if key != "ratio_to_s_slam":
            axes.plot(peers, [values[0] / peers[0] * n for n in peers], ":", color="#888888", label="linear in peers")
            axes.legend(frameon=False)
        axes.set(xlabel="Peers", ylabel=label, xticks=peers, ylim=(0.0, None))
        clean(axes)
    return figure
