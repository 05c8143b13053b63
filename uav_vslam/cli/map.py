# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam map`: the surface of what was flown over, from the images of a flight and its smoothed poses."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING

from uav_vslam.argument_types import length_of_map
from uav_vslam.cli.arguments import RESULTS, add_datum, datum_of, first_given
from uav_vslam.cli.messages import say, warn_each
from uav_vslam.cli.progress import progress_bar
from uav_vslam.cli.run import SHEET, add_options, configured, flown

if TYPE_CHECKING:
    from uav_vslam.cli.map_inputs import MappedFlight
    from uav_vslam.evaluation.files.geodetic import Datum
    from uav_vslam.mapping.summary import MapFrame
    from uav_vslam.mapping.surface.mapper import SurfaceMapper

HELP = "map the surface that was flown over: run recordings, or take a results folder, and read the images again"
EXAMPLES = """examples:
  uav-vslam map flight --config kagaru                fly, smooth, map; the map goes to RESULT/map/
  uav-vslam map config/fleet_demo.yaml --cell 1       several vehicles in one map
  uav-vslam map results/latest --pixel 0.03           a finer orthomosaic, of a low flight
  uav-vslam map results/latest                        map a flight that has been run, with the poses found there
  uav-vslam map results/latest --bags moved/flight    the recordings have moved since
  uav-vslam map results/latest --datum -28.2325 153.0012 20    GeoTIFFs for a GIS

One vehicle is mapped with its smoothed poses; several with those moved to where the fused ones are (C-SLAM), in the
map frame that they share. The height's sigma is that given the poses. RESULT/map/ holds height.png, height.tif,
the orthomosaic (PNG with a world file), the textured model (GLB, PLY), map.json and the tiles of the height grid.
With --datum, orthomosaic.tif and height.tif are GeoTIFFs in a transverse Mercator projection centred there, and heights
count from its altitude. The map's x axis points east, or --yaw degrees counter-clockwise from there. The map grows in
RESULT/map.partial: one that was interrupted leaves no RESULT/map, and can be started again.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "inputs",
        nargs="+",
        type=Path,
        metavar="BAG|FLEET.yaml|RESULT",
        help="bags or one fleet file, as for run, or the results folder of a run",
    )
    add_options(parser)
    parser.add_argument(
        "--cell",
        type=length_of_map("cell_m"),
        default=0.5,
        metavar="M",
        help="side of a cell of the height grid [m] (default 0.5)",
    )
    parser.add_argument(
        "--pixel",
        type=length_of_map("pixel_m"),
        metavar="M",
        help="side of a pixel of the orthomosaic [m] (default 0.1, or more if that took over 200 megapixels)",
    )
    add_datum(parser, "GeoTIFFs")
    parser.add_argument(
        "--bags",
        nargs="+",
        type=Path,
        metavar="BAG",
        help="recordings of a results folder (default: those that it names)",
    )


def run(args: argparse.Namespace) -> int:
    """Fly, or take a flight; map; print figures and times."""
    import cv2

    from uav_vslam.cli.map_inputs import is_result, mapped_flights, require_one_frame
    from uav_vslam.datasets.unfinished import require_new, unfinished
    from uav_vslam.errors import ConfigError, UavVslamError
    from uav_vslam.report.page.map_folder import MAP
    from uav_vslam.report.page.page import write_page

    if args.yaw is not None and args.datum is None:
        raise ConfigError("--yaw DEG turns the map about its origin; give that too, with --datum LAT LON ALT")
    datum = datum_of(args) if args.datum else None
    code, folder = 0, args.inputs[0]
    if not is_result(folder):
        if args.bags:
            raise UavVslamError("--bags goes with a results folder; name the recordings themselves to run them")
        bags, configs = configured(args)
        require_one_frame(configs)
        folder, code = flown(args, bags, configs)
    elif len(args.inputs) > 1:
        raise UavVslamError(f"{folder} is a results folder, so no other input goes with it; map one at a time")
    elif given := first_given(_of_runs(args)):
        raise ConfigError(f"{folder} is a results folder, of a flight that has been run: {given} has no effect")
    else:
        folder = folder.resolve()  # results/latest may lead elsewhere before the map is done
    out = folder / MAP
    if out.exists():
        raise UavVslamError(f"{out} exists already; move it away to map this flight again")
    flights, frame = mapped_flights(folder, args.bags, args.vehicles)
    if datum is not None:
        frame = replace(frame, north_up=datum.yaw_deg == 0.0)
    warn_each(require_new(out))
    cv2.setNumThreads(1)
    with unfinished(out) as partial:
        cells = write_map(flights, frame, partial, args.cell, args.pixel, datum)
    if cells == 0:
        rmtree(out)  # another attempt may follow
        say("nothing was mapped: no pair of views gave a height; the figures above say why")
        return max(code, 1)
    print(f"map: {out}")
    if not args.no_plots:
        print(f"page: {write_page([folder])}")
    return code


def _of_runs(args: argparse.Namespace) -> dict[str, object]:
    """Return those options, by name, that only tell how to run a flight; false where they were not given."""
    names = ("config", "set", "mode", "map", "link", "name", "no_smoothing", "no_maps", "video")
    given = {f"--{name.replace('_', '-')}": getattr(args, name) for name in names}
    return given | {"--results": args.results != Path(RESULTS), "--sheet": args.sheet != SHEET}


def write_map(
    flights: list[MappedFlight],
    frame: MapFrame,
    folder: Path,
    cell_m: float,
    pixel_m: float | None,
    datum: Datum | None,
) -> int:
    """Map flights into a new folder, print what was found, and return the number of cells with a height.

    Args:
        flights: to be mapped.
        frame: of their poses.
        folder: for the files.
        cell_m: side of a cell of the height grid [m].
        pixel_m: side of a pixel of the orthomosaic [m]; None for the default.
        datum: of the map frame, if known.
    """
    from uav_vslam.cli.map_picture import default_pixel_m, write_picture_and_model
    from uav_vslam.evaluation.files.writing import write_json
    from uav_vslam.mapping.overlap import Overlap
    from uav_vslam.mapping.progress import counted
    from uav_vslam.mapping.surface.grid import HeightGrid
    from uav_vslam.mapping.surface.mapper import SurfaceMapper
    from uav_vslam.mapping.surface.tiles import TILES
    from uav_vslam.mapping.surface_files import FIGURES, write_surface
    from uav_vslam.report.height_picture import draw_ground, frame_of
    from uav_vslam.report.map_table import print_map

    grid, overlap = HeightGrid(cell_m, folder / TILES), Overlap()
    mapper = SurfaceMapper(grid)
    with progress_bar("mapping", sum(len(flight) for flight in flights)) as advance:
        for view in counted((view for flight in flights for view in flight.views()), advance):
            mapper.add_view(view)
            overlap.add(view)
    mapper.finish()
    tree = write_surface(grid, overlap, mapper, folder, frame, datum)
    if grid.extent.columns:
        tree |= write_picture_and_model(flights, grid, folder, pixel_m or default_pixel_m(grid.extent), datum)
        for vehicle, share in tree.pop("shares").items():
            tree["vehicles"][vehicle]["share"] = share
    write_json(folder / FIGURES, tree)
    extent, counts = overlap.count(grid)
    draw_ground(grid.height(extent), counts, extent.bounds_m, frame_of(north=frame.north_up), folder)
    print_map(tree, _times_ms(mapper))
    warn_each(doubts(mapper))
    return int(tree["surface"]["cells"])


def doubts(mapper: SurfaceMapper) -> Iterator[str]:
    """Yield why pairs of views were refused, as far as something can be done about it."""
    from uav_vslam.mapping.surface.mapper import FEW_MATCHES, NOT_BELOW, SMALL_CELLS

    if mapper.refused[NOT_BELOW] > mapper.pairs:
        yield (
            "most pairs of views do not look down on ground that both show: only what a camera looks down on is "
            "mapped, not what it sees ahead, as in a room"
        )
    if mapper.least_cell_m:
        count, cell_m, least_m = mapper.refused[SMALL_CELLS], mapper.grid.cell_m, mapper.least_cell_m
        yield f"{count} pairs have pixels too large for cells of {cell_m:g} m; use --cell {least_m:.2g}"
    if mapper.refused[FEW_MATCHES] > mapper.pairs:
        yield "most pairs of views have few matches: is this the recording of these poses, and has the ground texture?"


def _times_ms(mapper: SurfaceMapper) -> dict[str, float]:
    """Return the processor time of each stage for a frame flown [ms]."""
    frames = max(sum(mapper.views.values()), 1)
    return {stage: 1e3 * seconds / frames for stage, seconds in mapper.seconds.items()}
