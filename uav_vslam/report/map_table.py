# SPDX-License-Identifier: Apache-2.0
"""A map's figures as tables for the terminal."""

from collections.abc import Mapping
from typing import Any

from uav_vslam.report.layout import figure_text, new_table, print_table, wide


def print_map(tree: Mapping[str, Any], times_ms: Mapping[str, float]) -> None:
    """Print the content of `map.json` and the processor time for a frame flown [ms], by stage."""
    console = wide()
    surface, views = tree["surface"], sum(vehicle["views"] for vehicle in tree["vehicles"].values())
    columns = (
        "Views",
        "Cell\n[m]",
        "GSD\n[m]",
        "Coverage\n[%]",
        "Filled\n[%]",
        "Median σ\n[m]",
        "Lowest\n[m]",
        "Highest\n[m]",
    )
    table = new_table(("Vehicles",), columns)
    low_m, high_m = surface.get("height_m", (None, None))
    figures = (tree["cell_m"], tree["gsd_m"], 100.0 * surface["coverage"], 100.0 * surface["filled"])
    texts = map(figure_text, (*figures, surface.get("median_sigma_m"), low_m, high_m))
    table.add_row(", ".join(tree["vehicles"]), str(views), *texts)
    print_table(table, console)
    refused = ", ".join(f"{reason} {count}" for reason, count in surface["refused_pairs"].items()) or "none"
    console.print(f"pairs of views: {surface['pairs']}; refused: {refused}", markup=False, highlight=False)
    stages = ", ".join(f"{stage} {ms:.1f}" for stage, ms in times_ms.items())
    total = sum(times_ms.values())
    console.print(f"processor time for a frame flown: {total:.1f} ms ({stages})", markup=False, highlight=False)
