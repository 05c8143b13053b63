# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study features`: extractors on image pairs."""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uav_vslam.cli.arguments import results_folder
from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.study.common import add_seeds, publish, seeds_of

if TYPE_CHECKING:
    from uav_vslam.datasets.image_sets import Layout
    from uav_vslam.studies.features.compute import FeatureLab
    from uav_vslam.studies.features.sets import ImageSet

HELP = "extractors on image pairs: points, matches with and without RANSAC, time, bands, and spacing of images"
EXAMPLES = """examples:
  uav-vslam study features                             the data sets that there are, and a rendered flight; minutes
  uav-vslam study features tno_nato_camp --seeds 0     one of them alone
  uav-vslam study features flight/ a.png,b.png         the images of a folder, first with later ones; and one pair
  uav-vslam study features --algorithms SIFT SURF ORB  minutes

Data sets by name are tno_nato_camp, odm_garfield and odm_caliterra, folders where UAV_VSLAM_DATA points.
"""
DRAWN = ("SIFT", "SURF")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    parser.add_argument(
        "images", nargs="*", metavar="SET", help="a data set's name, a folder of images, or two files with a comma"
    )
    parser.add_argument("--algorithms", nargs="+", metavar="NAME", default=[], help="which (default all)")
    parser.add_argument("--width", type=int, default=360, help="wider images are shrunk to this [px] (default 360)")
    add_seeds(parser, 1, "how many rendered flights too")
    parser.add_argument("--results", type=results_folder, default="results", help="where results go (default results/)")


def run(args: argparse.Namespace) -> int:
    """Run the study; print its tables, write and draw them, and draw matches."""
    from uav_vslam.errors import ConfigError
    from uav_vslam.studies.features.compute import ALGORITHMS, NOTES, FeatureLab, count_jobs, feature_rows
    from uav_vslam.studies.features.front_end import accepted_rows
    from uav_vslam.studies.features.plot import draw_features
    from uav_vslam.studies.features.sets import rendered_set
    from uav_vslam.studies.features.trends import trend_rows

    methods = args.algorithms or list(ALGORITHMS)
    if unknown := set(methods) - set(ALGORITHMS):
        raise ConfigError(f"algorithm {sorted(unknown)[0]!r} is not known; use some of {', '.join(ALGORITHMS)}")
    sets = [_read(text, args.width) for text in args.images or _at_hand()]
    sets += [rendered_set(seed, args.width) for seed in seeds_of(args)]
    if not sets:
        raise ConfigError("there are no images: name a folder, let UAV_VSLAM_DATA point to the data, or give --seeds 1")
    lab = FeatureLab()
    with progress_bar("study features", count_jobs(sets, methods)) as advance:
        rows = feature_rows(sets, lab, methods, advance)
    rows = [*trend_rows(rows), *accepted_rows(sets, seeds_of(args)), *rows]

    def draw(tree: dict[str, Any], folder: Path) -> list[Path]:
        _draw_matches(sets, lab, [method for method in methods if method in DRAWN], folder / "matches")
        return draw_features(tree, folder)

    return publish("features", rows, seeds_of(args), args.results, notes=NOTES, plot=draw)


def _at_hand() -> list[str]:
    """Return the names of the data sets that the machine has."""
    from uav_vslam.datasets.image_sets import LAYOUTS

    root = os.environ.get("UAV_VSLAM_DATA")
    return [name for name in LAYOUTS if root and (Path(root) / name).is_dir()]


def _read(text: str, width: int) -> ImageSet:
    """Return the set that an argument stands for."""
    from uav_vslam.datasets.image_sets import LAYOUTS, Layout, files_of
    from uav_vslam.errors import ConfigError

    if "," in text:
        pair = [Path(part) for part in text.split(",")]
        name = " ".join(dict.fromkeys(path.parent.name or "." for path in pair))
        return _loaded(name, Layout({"images": ""}, (1,)), {"images": dict(enumerate(pair))}, width)
    if text in LAYOUTS:
        folder = Path(os.environ.get("UAV_VSLAM_DATA", ".")) / text
        if not folder.is_dir():
            raise ConfigError(f"data set {text} is not at {folder}; let UAV_VSLAM_DATA name the folder that holds it")
        return _loaded(text, LAYOUTS[text], files_of(LAYOUTS[text], folder), width)
    if not Path(text).is_dir():
        raise ConfigError(f"{text} is no folder, no pair A,B of files and none of {', '.join(LAYOUTS)}")
    layout = Layout({"images": "*"})
    return _loaded(Path(text).resolve().name, layout, files_of(layout, Path(text)), width)


def _loaded(name: str, layout: Layout, files: dict[str, dict[int, Path]], width: int) -> ImageSet:
    """Read a set's images and shrink the wide ones."""
    from uav_vslam.datasets.image_sets import read_image, shift_between
    from uav_vslam.studies.features.sets import ImageSet, View, narrowed, steady

    bands = {
        band: {k: View(name, band, k, path.stem, narrowed(read_image(path), width)) for k, path in paths.items()}
        for band, paths in files.items()
    }
    truth = None
    if layout.still:
        last = {band: views[max(views)].image for band, views in bands.items()}
        truth = steady(
            {(b, k): shift_between(view.image, last[b]) for b, vs in bands.items() for k, view in vs.items()}
        )
    return ImageSet(name, bands, layout.spacings, layout.usual, layout.cross, truth, layout.still)


def _draw_matches(sets: list[ImageSet], lab: FeatureLab, methods: list[str], folder: Path) -> None:
    """Draw the matches of each set's bands and between them."""
    from uav_vslam.studies.features.match_picture import match_picture, save_match_picture
    from uav_vslam.studies.features.sets import cross_pairs, usual_pairs

    for pair in (pair for images in sets for pair in [*usual_pairs(images), *cross_pairs(images)]):
        for method in methods:
            found = lab.match(method, pair)
            images = pair.first.image, pair.second.image
            figure = match_picture(images, (found.first, found.second), found.kept, f"{method}, {pair.label}")
            save_match_picture(folder / f"{re.sub(r'[^a-z0-9]+', '_', f'{method} {pair.label}'.lower())}.png", figure)
