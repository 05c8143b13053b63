# SPDX-License-Identifier: Apache-2.0
"""The resolved configurations of flights: where they differ, and all of them."""

from collections.abc import Iterator, Sequence
from typing import Any

import yaml

from uav_vslam.report.page.flight import FlightFiles
from uav_vslam.report.page.html import Cell, Markup, section, table, tag

PARAMETERS = "ros__parameters"


def configuration_section(flights: Sequence[FlightFiles]) -> Markup | None:
    """Return the settings that differ between vehicles or flights, and each flight's file; None without any."""
    columns = {title: settings for flight in flights for title, settings in _columns(flight, several=len(flights) > 1)}
    if not columns:
        return None
    files = [
        tag(
            "details",
            tag("summary", f"config.yaml of {flight.label}" if len(flights) > 1 else "config.yaml"),
            tag("pre", yaml.safe_dump(flight.config, sort_keys=False), tabindex="0"),
        )
        for flight in flights
        if flight.config
    ]
    return section("configuration", "Configuration", _differences(columns), _all(columns), *files)


def flat(tree: Any, prefix: str = "") -> dict[str, str]:
    """Return the leaves of a tree of settings as text, by their keys joined by points."""
    if not isinstance(tree, dict):
        return {prefix: str(tree)}
    leaves: dict[str, str] = {}
    for key, value in tree.items():
        leaves |= flat(value, f"{prefix}.{key}" if prefix else str(key))
    return leaves


def differing(columns: dict[str, dict[str, str]]) -> list[str]:
    """Return the keys of settings that are not the same in all columns, or not in all."""
    keys = dict.fromkeys(key for settings in columns.values() for key in settings)
    return [key for key in keys if len({settings.get(key) for settings in columns.values()}) > 1]


def _columns(flight: FlightFiles, *, several: bool) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield a title and the settings of each vehicle; one for all if nothing differs."""
    trees = {
        name.strip("/*"): flat(tree.get(PARAMETERS, tree) if isinstance(tree, dict) else tree)
        for name, tree in flight.config.items()
    }
    if len({tuple(tree.items()) for tree in trees.values()}) == 1:
        trees = {", ".join(trees): next(iter(trees.values()))}
    for name, tree in trees.items():
        yield (f"{flight.label}: {name}" if several else name), tree


def _differences(columns: dict[str, dict[str, str]]) -> Markup | None:
    if len(columns) < 2:
        return None
    keys = differing(columns)
    if not keys:
        return tag("p", "All settings are the same.")
    return tag("div", _table(columns, keys, "Settings that differ"), class_="differences")


def _all(columns: dict[str, dict[str, str]]) -> Markup:
    keys = list(dict.fromkeys(key for settings in columns.values() for key in settings))
    return tag(
        "details",
        tag("summary", f"All {len(keys)} settings"),
        tag("label", "Filter ", tag("input", type="search", data_filter="all-settings")),
        tag("div", _table(columns, keys, "Resolved settings"), id="all-settings"),
    )


def _table(columns: dict[str, dict[str, str]], keys: Sequence[str], caption: str) -> Markup:
    different = set(differing(columns))
    rows: list[list[Cell]] = [
        [
            (key or "value", "key"),
            *((settings.get(key, "–"), "differs" if key in different else "") for settings in columns.values()),
        ]
        for key in keys
    ]
    return table(["Setting", *columns], rows, caption=caption)
