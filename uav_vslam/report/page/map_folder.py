# SPDX-License-Identifier: Apache-2.0
"""The map of a flight, `RESULT/map/`: height, orthomosaic, model, and how good they are.

Read are map.json, height.png, orthomosaic.jpg (or .png), overlap.png and model.glb; each may be missing.

    map.json    cell_m, gsd_m; bounds_m: [west, south, east, north]; vehicles: {name: {views, share}};
                surface: {cells, coverage, filled, median_sigma_m, height_m: [min, max]};
                orthomosaic: {m_per_px, width, height, seam_px}; model: {triangles, bytes};
                accuracy: {ce90_m, le90_m, claimed}; frame; north_up; datum: {latitude_deg, longitude_deg, height_m}
    model.glb   textured mesh in the map frame [m], z up
"""

import base64
from collections.abc import Sequence
from pathlib import Path

from uav_vslam.report.layout import figure_text
from uav_vslam.report.page.flight import Figures, FlightFiles, read_json
from uav_vslam.report.page.html import Cell, Markup, section, table, tag
from uav_vslam.report.page.pictures import figure, photograph

MAP, SUMMARY, MODEL = "map", "map.json", "model.glb"
ORTHOMOSAICS = ("orthomosaic.jpg", "orthomosaic.png")
LARGEST_MODEL_BYTES = 3_000_000
SHARES = {"orthomosaic": 0.6, "height": 0.2, "overlap": 0.2}  # of the bytes for pictures


def map_sections(flights: Sequence[FlightFiles], picture_bytes: int) -> list[Markup]:
    """Return the sections of each flight's map that is there.

    Args:
        flights: of the page.
        picture_bytes: for all pictures of maps together.
    """
    mapped = [flight for flight in flights if (flight.folder / MAP / SUMMARY).exists()]
    return [
        _section(flight, picture_bytes // len(mapped), LARGEST_MODEL_BYTES // len(mapped), several=len(flights) > 1)
        for flight in mapped
    ]


def quality_rows(summary: Figures) -> list[list[Cell]]:
    """Return what map.json says, a row a figure: name, value, unit; left out is what it does not say."""
    surface, mosaic = summary.get("surface") or {}, summary.get("orthomosaic") or {}
    accuracy, model = summary.get("accuracy") or {}, summary.get("model") or {}
    low, high = surface.get("height_m") or (None, None)
    west, south, east, north = summary.get("bounds_m") or (None,) * 4
    along_x, along_y = ("East to west", "North to south") if _north_up(summary) else ("Along x", "Along y")
    source = "claimed" if accuracy.get("claimed") else "against the truth"
    figures = [
        ("Ground sampling distance", summary.get("gsd_m"), "m"),
        ("Cell of the height map", summary.get("cell_m"), "m"),
        ("Orthomosaic", mosaic.get("m_per_px"), "m/px"),
        ("Seams", mosaic.get("seam_px"), "px"),
        (f"CE90, horizontal, {source}", accuracy.get("ce90_m"), "m"),
        (f"LE90, height, {source}", accuracy.get("le90_m"), "m"),
        ("Median 1σ of the height", surface.get("median_sigma_m"), "m"),
        ("Coverage", _percent(surface.get("coverage")), "%"),
        ("Filled from neighbours", _percent(surface.get("filled")), "%"),
        (along_x, None if west is None or east is None else east - west, "m"),
        (along_y, None if south is None or north is None else north - south, "m"),
        ("Lowest height", low, "m"),
        ("Highest height", high, "m"),
        ("Triangles of the model", model.get("triangles"), ""),
    ]
    return [
        [name, (f"{value}" if isinstance(value, int) else figure_text(value), "number"), unit]
        for name, value, unit in figures
        if value is not None
    ]


def _section(flight: FlightFiles, picture_bytes: int, model_bytes: int, *, several: bool) -> Markup:
    folder = flight.folder / MAP
    summary = read_json(folder / SUMMARY)
    ending = f": {flight.label}" if several else ""
    rows = quality_rows(summary)
    axes = "north up" if _north_up(summary) else "x to the right, y up"
    vehicles = [
        [name, str(found.get("views", "–")), f"{100.0 * found['share']:.0f} %" if "share" in found else "–"]
        for name, found in (summary.get("vehicles") or {}).items()
    ]
    return section(
        f"map-{flight.label}" if several else "map",
        f"Map{ending}",
        tag(
            "div",
            table(["Figure", "Value", "Unit"], rows, caption="Quality of the map") if rows else None,
            table(["Vehicle", "Views", "Share"], vehicles, caption="Views per vehicle") if vehicles else None,
            class_="cells",
        ),
        picture_of(folder, ORTHOMOSAICS, f"Orthomosaic, {axes}", round(SHARES["orthomosaic"] * picture_bytes)),
        _model(folder / MODEL, model_bytes),
        tag(
            "div",
            picture_of(folder, ("height.png",), "Height map", round(SHARES["height"] * picture_bytes)),
            picture_of(folder, ("overlap.png",), "Views per cell", round(SHARES["overlap"] * picture_bytes)),
            class_="cells",
        ),
        text=f"Frame: {summary.get('frame', 'map')}{_datum(summary.get('datum'))}.",
    )


def picture_of(folder: Path, names: Sequence[str], text: str, most_bytes: int) -> Markup | None:
    """Return the first of some pictures that is there, as a figure; None without any."""
    path = next((folder / name for name in names if (folder / name).exists()), None)
    return None if path is None else figure(photograph(path, most_bytes), text)


def _model(path: Path, most_bytes: int) -> Markup | None:
    if not path.exists():
        return None
    size = path.stat().st_size
    if size > most_bytes:
        text = f"{path.parent.name}/{path.name} has {size / 1e6:.1f} MB, too much for this page; open it by itself."
        return tag("p", text)
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return tag(
        "figure",
        tag("div", tag("script", Markup(content), type="text/plain"), data_model=True, class_="model"),
        tag("figcaption", "Textured model: drag to turn, wheel to zoom, right button or two fingers to move"),
    )


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _datum(datum: Figures | None) -> str:
    if not datum:
        return ""
    turned = f", x axis {yaw:g}° counter-clockwise from east" if (yaw := datum.get("yaw_deg")) else ""
    return f", origin at {datum['latitude_deg']:.6f}°, {datum['longitude_deg']:.6f}°, {datum['height_m']:.1f} m{turned}"


def _north_up(summary: Figures) -> bool:
    """Return whether the map's y axis points north; maps of earlier versions say it by the datum's yaw alone."""
    return bool(summary.get("north_up", not (summary.get("datum") or {}).get("yaw_deg")))
