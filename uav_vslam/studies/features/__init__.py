# SPDX-License-Identifier: Apache-2.0
"""Extractors on image pairs."""

from __future__ import annotations

import argparse

from uav_vslam.argument_types import whole_number
from uav_vslam.studies.engine.study import Findings, Progress, Study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare images and algorithms."""
    parser.add_argument(
        "images", nargs="*", metavar="SET", help="a data set's name, a folder of images, or two files with a comma"
    )
    parser.add_argument("--algorithms", nargs="+", metavar="NAME", default=[], help="which (default all)")
    parser.add_argument(
        "--width", type=whole_number(64), default=360, help="wider images are shrunk to this [px] (default 360)"
    )


def run(args: argparse.Namespace, seeds: list[int], progress: Progress) -> Findings:
    """Match all pairs of all sets, and of a rendered flight for each seed."""
    from uav_vslam.errors import ConfigError
    from uav_vslam.studies.features.compute import ALGORITHMS, NOTES, FeatureLab, count_jobs, feature_rows
    from uav_vslam.studies.features.front_end import accepted_rows
    from uav_vslam.studies.features.named_sets import available_sets, read_set
    from uav_vslam.studies.features.plot import draw_with_matches
    from uav_vslam.studies.features.sets import rendered_set
    from uav_vslam.studies.features.trends import trend_rows

    methods = args.algorithms or list(ALGORITHMS)
    if unknown := set(methods) - set(ALGORITHMS):
        raise ConfigError(f"algorithm {sorted(unknown)[0]!r} is not known; use some of {', '.join(ALGORITHMS)}")
    sets = [read_set(text, args.width) for text in args.images or available_sets()]
    sets += [rendered_set(seed, args.width) for seed in seeds]
    if not sets:
        raise ConfigError("there are no images: name a folder, let UAV_VSLAM_DATA point to the data, or give --seeds 1")
    lab = FeatureLab()
    rows = feature_rows(sets, lab, methods, progress(count_jobs(sets, methods)))
    rows = [*trend_rows(rows), *accepted_rows(sets, seeds), *rows]
    return Findings(rows, NOTES, draw=draw_with_matches(sets, lab, methods))


STUDY = Study(
    help="extractors on image pairs: points, matches with and without RANSAC, time, bands, and spacing of images",
    takes="minutes",
    examples="""examples:
  uav-vslam study features                             the data sets that there are, and a rendered flight
  uav-vslam study features tno_nato_camp --seeds 0     one of them alone
  uav-vslam study features flight/ a.png,b.png         the images of a folder, first with later ones; and one pair
  uav-vslam study features --algorithms SIFT SURF ORB

Data sets by name are tno_nato_camp, odm_garfield and odm_caliterra, folders where UAV_VSLAM_DATA points. The seeds are
those of rendered flights.
""",
    run=run,
    add_arguments=add_arguments,
    seeds=1,
    seedless=True,
    workers=0,
)
