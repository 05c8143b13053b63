# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam mosaic`: a folder of aerial pictures to an orthomosaic, without SLAM."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uav_vslam.argument_types import length_of_map, positive_number
from uav_vslam.cli.arguments import add_results, first_given
from uav_vslam.cli.messages import warn_each
from uav_vslam.cli.progress import progress_bar

if TYPE_CHECKING:
    from uav_vslam.mapping.pictures.reading import Folder
    from uav_vslam.mapping.pictures.reconstruction import Reconstruction

HELP = "join a folder of aerial pictures into an orthomosaic"
EXAMPLES = """examples:
  uav-vslam mosaic pictures                       JPEG, PNG or TIFF; focal length and GPS from EXIF or gps.csv
  uav-vslam mosaic pictures --focal-px 2890       a known focal length in pixels; else it is estimated
  uav-vslam mosaic pictures --height 70           no GPS: flown 70 m above the ground, for a mosaic in metres
  uav-vslam mosaic pictures --pixel 0.1           a coarser mosaic, 10 cm a pixel
  uav-vslam mosaic pictures --method homography   a chain of homographies, as a baseline; in pixels of the first picture

Pictures should look down, and overlap by 60 % along and 30 % across the path. gps.csv, in the same folder, has the
columns file,lat_deg,lon_deg,alt_m and optionally datetime. Writes report.html, poses.csv, cameras.json, mosaic.json
(quality) and map/: orthomosaic, overlap.png and map.json, into a new folder below results/, to which results/latest
leads.
"""
MOST_PIXELS = 80e6  # of a mosaic whose pixel is not given


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("folder", type=Path, help="of the pictures")
    parser.add_argument("--focal-px", type=positive_number, metavar="PX", help="focal length of all pictures [px]")
    parser.add_argument(
        "--height", type=positive_number, metavar="M", help="median height above ground [m]; it scales the mosaic"
    )
    parser.add_argument(
        "--pixel",
        type=length_of_map("pixel_m"),
        metavar="M",
        help="side of the mosaic's pixels [m] (default: that of the pictures)",
    )
    parser.add_argument(
        "--method",
        choices=("bundle", "homography"),
        default="bundle",
        help="homography: the thesis's chain, without poses, surface and blending, as a baseline (default bundle)",
    )
    parser.add_argument("--name", help="of the results folder (default: that of the pictures' folder)")
    add_results(parser)


def run(args: argparse.Namespace) -> int:
    """Adjust, draw, write, print; return the exit status."""
    import cv2

    from uav_vslam.errors import ConfigError
    from uav_vslam.evaluation.output import new_folder
    from uav_vslam.mapping.pictures.reading import read_folder
    from uav_vslam.report.mosaic_table import print_mosaic
    from uav_vslam.report.page.page import write_page

    useless = {"--height": args.height, "--focal-px": args.focal_px}
    if args.method == "homography" and (given := first_given(useless)):
        raise ConfigError(f"--method homography has no use for {given}: it knows neither cameras nor heights")
    cv2.setNumThreads(1)
    folder = read_folder(args.folder, focal_px=args.focal_px)
    warn_each(folder.warnings)
    if args.method == "homography":
        return _chained(folder, args)
    found, undecoded = _reconstructed(folder, args)
    warn_each(found.warnings)
    with new_folder(args.results, args.name or f"{args.folder.resolve().name}_mosaic") as results:
        figures = _write(found, [*folder.warnings, *undecoded, *found.warnings], args.pixel, results)
        page = write_page([results])
    print_mosaic(figures)
    print(f"results: {results}")
    print(f"page: {page}")
    return 0


def _reconstructed(folder: Folder, args: argparse.Namespace) -> tuple[Reconstruction, list[str]]:
    """Return the reconstruction, and the warning, already printed, of pictures that can't be decoded."""
    from uav_vslam.errors import PictureError
    from uav_vslam.mapping.pictures.features import detect_all
    from uav_vslam.mapping.pictures.gps_positions import local_positions
    from uav_vslam.mapping.pictures.pairs import candidates, match_all
    from uav_vslam.mapping.pictures.reading import FEWEST, listed
    from uav_vslam.mapping.pictures.reconstruction import reconstruct

    with progress_bar("finding points", len(folder.pictures)) as advance:
        detected = detect_all(folder.pictures, on_picture=advance)
    undecoded = [f"left out, can't be decoded: {listed(detected.undecoded)}"] if detected.undecoded else []
    warn_each(undecoded)
    if len(detected.pictures) < FEWEST:
        raise PictureError(f"{len(detected.pictures)} pictures can be decoded; a mosaic needs {FEWEST} or more")
    pictures, features = detected.pictures, detected.features
    pairs = candidates(features, local_positions(pictures)[0][:, :2])
    sides = [max(picture.width, picture.height) for picture in pictures]
    with progress_bar("matching pairs", len(pairs)) as advance:
        matched = match_all(features, sides, pairs, on_pair=advance)
    found = reconstruct(pictures, features, matched, focal_known=args.focal_px is not None, height_m=args.height)
    return found, undecoded


def _chained(folder: Folder, args: argparse.Namespace) -> int:
    """Draw the baseline; return the exit status."""
    from uav_vslam.evaluation.output import new_folder
    from uav_vslam.mapping.pictures.chain import draw_chain
    from uav_vslam.report.page.map_folder import MAP

    with (
        progress_bar("joining", 2 * len(folder.pictures)) as advance,
        new_folder(args.results, args.name or f"{args.folder.resolve().name}_chain") as results,
    ):
        (results / MAP).mkdir()
        path = draw_chain(folder.pictures, args.pixel or 1.0, results / MAP, on_picture=advance)
    print(f"results: {results}, {path.name} in pixels of the first picture")
    return 0


def _write(found: Reconstruction, warnings: list[str], pixel_m: float | None, results: Path) -> dict[str, Any]:
    """Draw the mosaic and write everything; return the figures of quality."""
    import numpy as np

    from uav_vslam.evaluation.files.writing import write_json
    from uav_vslam.mapping.pictures import output
    from uav_vslam.mapping.pictures.drawing import PASSES, draw
    from uav_vslam.report.height_picture import draw_ground, frame_of
    from uav_vslam.report.mosaic_table import unit_of
    from uav_vslam.report.page.map_folder import MAP
    from uav_vslam.report.page.mosaic_page import MOSAIC, POSES

    folder = results / MAP
    folder.mkdir()
    counts = output.overlap_counts(found)
    overlap = output.overlap_figures(counts, found.surface.raster.cell_m)
    frame = frame_of(north=found.placement.datum is not None, unit=unit_of(found.placement.scale))
    height = np.where(counts > 0, found.surface.grid, np.nan)
    shown = found.surface.raster.around(*np.nonzero(counts))  # the surface reaches further
    cut = shown.within(found.surface.raster)
    draw_ground(height[cut], counts[cut], shown.bounds_m, frame, folder, label="Pictures")
    pixel_m = pixel_m or output.pixel_size_m(found.gsd_m, overlap["area_m2"], MOST_PIXELS)
    with progress_bar("drawing", PASSES * len(found.adjusted.used)) as advance:
        drawn = draw(found, counts, pixel_m, folder, on_view=advance)
    figures = output.quality(found) | {"overlap": overlap, "warnings": warnings} | drawn
    output.write_poses(found, results / POSES, unit=frame.unit)
    write_json(results / "cameras.json", figures["cameras"])
    write_json(results / MOSAIC, figures)
    return figures
