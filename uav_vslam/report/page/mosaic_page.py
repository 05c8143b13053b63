# SPDX-License-Identifier: Apache-2.0
"""A mosaic of plain pictures as sections of a page: the picture, how good it is, and what became of each picture."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uav_vslam.errors import UavVslamError
from uav_vslam.report.mosaic_table import rows, unit_of
from uav_vslam.report.page.flight import read_json
from uav_vslam.report.page.html import Markup, section, table, tag
from uav_vslam.report.page.map_folder import MAP, ORTHOMOSAICS, picture_of

MOSAIC, POSES = "mosaic.json", "poses.csv"
PICTURE_BYTES = {"orthomosaic": 3_000_000, "height": 400_000, "overlap": 400_000}
COLUMNS = {  # of poses.csv, with their titles
    "picture": "Picture",
    "x_{unit}": "x [{unit}]",
    "y_{unit}": "y [{unit}]",
    "z_{unit}": "z [{unit}]",
    "points": "Points",
    "reprojection_px": "Reprojection error [px]",
}


def is_mosaic(folder: Path) -> bool:
    """Return whether a folder holds the results of `uav-vslam mosaic`."""
    return (folder / MOSAIC).exists()


def mosaic_sections(folder: Path) -> tuple[dict[str, Any], list[Markup]]:
    """Return the tree of mosaic.json and the sections of its page.

    Raises:
        UavVslamError: a file is damaged or missing.
    """
    tree = read_json(folder / MOSAIC)
    quality = _quality(tree, folder)
    mosaic = _picture(folder / MAP, ORTHOMOSAICS, "The mosaic", PICTURE_BYTES["orthomosaic"])
    overlap = _picture(folder / MAP, ("overlap.png",), "Pictures that show each place", PICTURE_BYTES["overlap"])
    height = _picture(folder / MAP, ("height.png",), "Height of the surface", PICTURE_BYTES["height"])
    sections = [
        section("orthomosaic", "Orthomosaic", mosaic, text=_frame(tree)),
        section("quality", "Quality", _warnings(tree), quality, tag("div", overlap, height, class_="cells")),
        section("pictures", "Pictures", _pictures(folder / POSES, tree)),
    ]
    return tree, sections


def _frame(tree: dict[str, Any]) -> str:
    if tree["scale"] == "none":
        return "The scale is arbitrary: one unit is a hundredth of the flight's height."
    return "North up." if "gps" in tree else "Lengths in metres; the direction of north is not known."


def _picture(folder: Path, names: Sequence[str], text: str, most_bytes: int) -> Markup:
    return picture_of(folder, names, text, most_bytes) or tag("p", f"{folder.name}/{names[0]} is missing.")


def _warnings(tree: dict[str, Any]) -> Markup | None:
    texts = [tag("li", text) for text in tree.get("warnings", [])]
    return tag("ul", *texts) if texts else None


def _quality(tree: dict[str, Any], folder: Path) -> Markup:
    try:
        lines = rows(tree)
    except TypeError as error:
        raise UavVslamError(f"{folder / MOSAIC} is damaged ({error}); make the mosaic again") from None
    return table(["Figure", "Value"], [[name, (value, "number")] for name, value in lines], caption="Quality")


def _pictures(path: Path, tree: dict[str, Any]) -> Markup:
    """Return the table of positions and errors, with the pictures that were left out below."""
    unit = unit_of(tree["scale"])
    try:
        with path.open(encoding="utf-8", newline="") as file:
            poses = [[row[name.format(unit=unit)] for name in COLUMNS] for row in csv.DictReader(file)]
    except (OSError, ValueError, KeyError, csv.Error) as error:
        raise UavVslamError(f"{path} can't be read ({error}); make the mosaic again") from None
    left_out = [[name, "left out", *[""] * (len(COLUMNS) - 2)] for name in tree["left_out"]]
    titles = [title.format(unit=unit) for title in COLUMNS.values()]
    return table(titles, [*poses, *left_out], caption="Positions and errors of the pictures")
