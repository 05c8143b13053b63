# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam calibrate`: image pairs of a chessboard or ChArUco board to calibration files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from uav_vslam.argument_types import length_m, positive
from uav_vslam.cli.arguments import add_results
from uav_vslam.cli.messages import say, warn_each
from uav_vslam.cli.progress import progress_bar

if TYPE_CHECKING:
    from uav_vslam.calibration.boards import Board
    from uav_vslam.calibration.pictures import Pictures

HELP = "calibrate a stereo rig from pictures of a chessboard or ChArUco board"
EXAMPLES = """examples:
  uav-vslam calibrate 'boards/left*.png' 'boards/right*.png' --board 9x6 --square 0.03
  uav-vslam calibrate boards --board 9x6 --square 0.03        left/ and right/, cam0/ and cam1/, or left*, right*
  uav-vslam calibrate BAG --board 9x6 --square 0.03           image topics of the only vehicle in a bag
  uav-vslam calibrate BAG --board 9x6 --square 0.03 --topics /camera/infra1/image_rect_raw /camera/infra2/image_rect_raw
  uav-vslam calibrate boards --board 11x8 --square 0.04 --charuco DICT_5X5_100 --marker 0.03
  uav-vslam calibrate boards --board 9x6 --square 0.03 --model equidistant         a fisheye lens

Twenty pictures with the board tilted different ways, out to the edges of both images, are a good number. Writes
left.yaml and right.yaml (ROS camera_info) and camchain.yaml (Kalibr), either of which `input.calibration` reads,
summary.json and calibration.png into a new folder below results/, to which results/latest leads.
"""
FIXED = {"plumb_bob": ["k3"], "rational_polynomial": [], "equidistant": []}  # by default
LARGEST_SQUARE_M = 1.0  # of a board that can be held before a camera
MOST = 60  # pairs of a bag, by default


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "inputs", nargs="+", metavar="PICTURES", help="two patterns LEFT RIGHT, a folder, or a bag of both cameras"
    )
    parser.add_argument("--board", type=_size, required=True, metavar="CxR", help="inner corners, as 9x6")
    parser.add_argument(
        "--square", type=length_m, required=True, metavar="M", help="side of a square [m]; it scales the baseline"
    )
    parser.add_argument("--charuco", metavar="DICT", help="the board is a ChArUco one of this dictionary: DICT_5X5_100")
    parser.add_argument("--marker", type=length_m, metavar="M", help="side of a ChArUco marker [m]")
    parser.add_argument("--legacy", action="store_true", help="ChArUco board drawn by OpenCV before 4.6")
    parser.add_argument("--model", choices=list(FIXED), default="plumb_bob", help="of the lenses (default plumb_bob)")
    parser.add_argument(
        "--fix", nargs="*", metavar="NAME", help="coefficients that stay zero (default k3 of plumb_bob; none: --fix)"
    )
    parser.add_argument(
        "--topics",
        nargs=2,
        metavar=("LEFT", "RIGHT"),
        help="of a bag's images (default: left/image_raw and right/image_raw of its only vehicle)",
    )
    parser.add_argument(
        "--most", type=positive, metavar="N", help=f"pairs to take from a bag, evenly spread (default {MOST})"
    )
    parser.add_argument("--name", help="of the results folder (default: that of the pictures' folder)")
    add_results(parser)
    parser.add_argument("--no-plots", action="store_true", help="write figures and calibration files only")


def run(args: argparse.Namespace) -> int:
    """Calibrate, write, print; return 2 if a bag is damaged, after calibrating from what can be read."""
    import cv2

    from uav_vslam.calibration.files import write_calibration
    from uav_vslam.calibration.procedure import calibrate, find_boards
    from uav_vslam.calibration.solve import Lens
    from uav_vslam.calibration.summary import build_summary
    from uav_vslam.datasets.rosbag import UpToDamage
    from uav_vslam.errors import CalibrationError
    from uav_vslam.evaluation.files.writing import write_json
    from uav_vslam.evaluation.output import new_folder
    from uav_vslam.evaluation.revision import git_revision
    from uav_vslam.report.calibration_plot import write_calibration_plot
    from uav_vslam.report.calibration_table import print_calibration

    cv2.setNumThreads(1)
    board, lens = _board(args), Lens(args.model, tuple(FIXED[args.model] if args.fix is None else args.fix))
    pictures = _pictures(args)
    read = UpToDamage(pictures)
    with progress_bar("finding boards", len(pictures)) as advance:
        try:
            boards = find_boards(read, board, on_pair=advance)
        except CalibrationError as error:
            raise CalibrationError(f"{error}; {read.error}" if read.error else str(error)) from None
    found = calibrate(boards, lens)
    name = args.name or _name(args.inputs[0])
    summary = build_summary(found, board, name=name, git=git_revision())
    with new_folder(args.results, name) as folder:
        files = write_calibration(found.solution.rig, folder)
        write_json(folder / "summary.json", summary)
        if not args.no_plots:
            write_calibration_plot(found, name, folder)
    print_calibration(summary)
    print(f"results: {folder}")
    print(f"use it:  input: {{calibration: [{', '.join(str(file.resolve()) for file in files[:2])}]}}")
    warn_each(found.warnings)
    if read.error:
        say(f"calibrated up to a break: {read.error}")
    return 2 if read.error else 0


def _pictures(args: argparse.Namespace) -> Pictures:
    from uav_vslam.calibration.pictures import FilePictures, pictures_of
    from uav_vslam.errors import CalibrationError

    pictures = pictures_of(args.inputs, topics=args.topics, most=args.most or MOST)
    if isinstance(pictures, FilePictures) and (args.topics or args.most):
        raise CalibrationError(f"--topics and --most belong to a bag; {args.inputs[0]} is of pictures")
    return pictures


def _board(args: argparse.Namespace) -> Board:
    from uav_vslam.calibration.boards import Charuco, Chessboard
    from uav_vslam.errors import CalibrationError

    columns, rows = args.board
    if args.square > LARGEST_SQUARE_M:
        raise CalibrationError(f"--square {args.square:g} is in metres; if millimetres, give {args.square / 1000:g}")
    if args.charuco is None:
        if args.marker is not None or args.legacy:
            raise CalibrationError("--marker and --legacy belong to a ChArUco board; name its dictionary by --charuco")
        return Chessboard(columns, rows, args.square)
    if args.marker is None:
        raise CalibrationError("--charuco needs --marker, the side of a marker [m]")
    return Charuco(columns, rows, args.square, args.marker, args.charuco, args.legacy)


def _size(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not COLUMNSxROWS, as 9x6")
    return int(columns), int(rows)


def _name(text: str) -> str:
    """Return a name for the results: that of the folder or bag, or of the folder that a pattern looks into."""
    path = Path(text)
    folder = path if path.exists() and path.suffix.lower() not in {".png", ".jpg", ".jpeg"} else path.parent
    return f"{folder.resolve().stem}_calibration"
