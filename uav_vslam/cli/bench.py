# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam bench`: how long each stage takes on this machine."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uav_vslam.cli.arguments import results_folder

if TYPE_CHECKING:
    from uav_vslam.simulation.scenario import SimulatedVehicle
    from uav_vslam.types import StereoFrame

HELP = "measure the speed of each stage"
EXAMPLES = """examples:
  uav-vslam bench
  uav-vslam bench --quick          a few repeats only, for a first look

Every time stands beside a yardstick measured in the same breath: compare the ratios, not the milliseconds, between
machines and revisions. All in one process and one thread; times are processor time.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("--quick", action="store_true", help="a few repeats only")
    parser.add_argument("--results", type=results_folder, default="results", help="where results go (default results/)")


def run(args: argparse.Namespace) -> int:
    """Measure; print the table and write study.json."""
    import cv2
    from rich.progress import Progress

    from uav_vslam.evaluation.output import write_study
    from uav_vslam.studies.bench.stages import QUICK, Effort

    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    with Progress(transient=True) as progress:
        task = progress.add_task("measuring", total=None)
        for row in measure(QUICK if args.quick else Effort()):
            rows.append(row)
            progress.update(task, description=f"measured: {row['method']}")
    _print(rows)
    print(f"results: {write_study('bench', rows, [], args.results)}")
    return 0


def measure(effort: Any) -> Iterator[dict[str, Any]]:
    """Yield a row per stage and condition."""
    from uav_vslam.slam.packet import ANCHOR, PacketPolicy
    from uav_vslam.studies.bench import back_end as back_end_speed
    from uav_vslam.studies.bench import matching as matching_speed
    from uav_vslam.studies.bench import stages as speed
    from uav_vslam.vision.compact_descriptors import COMPACT

    vehicle, frames = speed.rendered_frames(effort.pairs)
    few = frames[:8]  # enough where each frame is measured by itself
    yield speed.stereo_front_end(vehicle, few, _sift())
    yield speed.live_front_end(vehicle, frames, _sift())
    yield from matching_speed.graph_matching(2000, min(effort.repeats, 10))
    for landmarks in (50, 100, 200, 400):
        yield back_end_speed.back_end(landmarks, effort.frames)
    yield back_end_speed.back_end(200, effort.frames, lag_s=back_end_speed.TRACK_LAG_S)
    yield back_end_speed.back_end(200, effort.frames // 3, factorisation=back_end_speed.QR)
    for shared in (10, 50, 200):
        yield speed.fusion(shared, min(effort.repeats, 30))
    for shared in (10, 50, 200):
        yield speed.weight_search(shared, min(effort.repeats, 10))
    yield from speed.packets(64, PacketPolicy(), effort.repeats)
    yield from speed.packets(22, PacketPolicy(form=ANCHOR, descriptor_basis=COMPACT), effort.repeats)
    yield speed.preintegration(effort.repeats)
    yield bag_reading(vehicle, few, repeats=min(effort.repeats, 10))


def bag_reading(vehicle: SimulatedVehicle, frames: list[StereoFrame], *, repeats: int) -> dict[str, Any]:
    """Time reading a bag's raw images into stereo frames, beside reading the bytes of its file."""
    import tempfile

    from uav_vslam.datasets.bag import open_flight
    from uav_vslam.datasets.flight_writer import FlightRecording, write_flights
    from uav_vslam.studies.bench.stages import take_turns

    imu = [sample for sample in vehicle.imu.samples() if sample.stamp_ns <= frames[-1].stamp_ns]
    recording = FlightRecording(vehicle.name, vehicle.rig, imu, (), frames, vehicle.initial)
    with tempfile.TemporaryDirectory(prefix="uav_vslam_bench_") as folder:
        path = Path(folder) / "bag"
        write_flights(path, [recording])
        (file,) = path.glob("*.mcap")
        flight = open_flight(path, vehicle.name)
        ms, ratio = take_turns([lambda: list(flight.iter_events())] * repeats, file.read_bytes)
        megabytes = file.stat().st_size / 1e6
    width, height = flight.image_size
    return {
        "method": "bag reading",
        "condition": f"mcap, raw {width}x{height}",
        "ms_per_frame": ms / len(frames),
        "mb_per_s": megabytes / (ms * 1e-3),
        "ratio": ratio,
        "yardstick": "reading its bytes",
    }


def _sift() -> Callable[[Any], object]:
    import cv2

    detector = cv2.SIFT_create()
    return lambda image: detector.detectAndCompute(image, None)


def _print(rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("Stage", "Condition")
    for heading in ("Time", "Ratio to"):
        table.add_column(heading, justify="right")
    table.add_column("Yardstick")
    for row in rows:
        yardstick = "\n".join([row["yardstick"], *_figures(row, "gtsam_")])
        table.add_row(row["method"], row["condition"], "\n".join(_figures(row)), f"{row['ratio']:.3g}", yardstick)
    Console().print(table)


def _figures(row: dict[str, Any], whose: str = "") -> list[str]:
    forms = {
        "ms_per_frame": "{:.3g} ms/frame",
        "ms_per_packet": "{:.3g} ms/packet",
        "us_per_landmark": "{:.3g} µs/landmark",
        "mb_per_s": "{:.3g} MB/s",
        "end_m": "end {:.3g} m",
        "ate_m": "ATE {:.3g} m",
    }
    return [form.format(row[whose + key]) for key, form in forms.items() if whose + key in row]
