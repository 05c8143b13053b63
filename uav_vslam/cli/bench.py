# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam bench`: how long each stage takes on this machine."""

from __future__ import annotations

import argparse
from typing import Any

from uav_vslam.argument_types import positive
from uav_vslam.cli.arguments import add_results

HELP = "measure the speed of each stage"
EXAMPLES = """examples:
  uav-vslam bench
  uav-vslam bench --quick          a few repeats only, for a quick check
  uav-vslam bench --nodes 30       instead: a vehicle's nodes beside one that does nothing, as processes; 30 s at rest,
                                   30 s at 200 and 30 s at 400 IMU readings a second

Each time comes with a reference measured alternately in the same run: compare ratios, not milliseconds, between
machines and revisions. All in one process and one thread; times are processor time.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("--quick", action="store_true", help="a few repeats only")
    parser.add_argument(
        "--nodes", type=positive, metavar="S", help="measure what nodes cost instead, for S seconds each time"
    )
    add_results(parser)


def run(args: argparse.Namespace) -> int:
    """Measure; print the table and write study.json."""
    if args.nodes:
        _print_nodes(args.nodes)
        return 0
    import cv2
    from rich.progress import Progress

    from uav_vslam.evaluation.output import write_study
    from uav_vslam.evaluation.study import study_tree
    from uav_vslam.studies.bench.compute import QUICK, Effort, measure

    cv2.setNumThreads(1)
    rows: list[dict[str, Any]] = []
    with Progress(transient=True) as progress:
        task = progress.add_task("measuring", total=None)
        for row in measure(QUICK if args.quick else Effort()):
            rows.append(row)
            progress.update(task, description=f"measured: {row['method']}")
    _print(rows)
    print(f"results: {write_study(study_tree('bench', rows, []), args.results)}")
    return 0


def _print_nodes(seconds: int) -> None:
    """Print what each node costs, and the ratio of its processor time to the bare node's in the same run."""
    from rich.progress import Progress
    from rich.table import Table
    from rich.text import Text

    from uav_vslam.report.terminal import Terminal
    from uav_vslam.ros.node_cost import IMU_RATES_HZ, NODES, node_costs

    table = Table("IMU [Hz]")
    table.add_column("Node", no_wrap=True)
    for heading in ("Cores", "Ratio", "Odometry [Hz]", "p50 [ms]", "p99 [ms]"):
        table.add_column(Text(heading), justify="right")  # in a str, [ms] would be markup
    with Progress(transient=True) as progress:
        costs = node_costs(seconds)
        for one in progress.track(costs, total=len(IMU_RATES_HZ) * len(NODES), description="measuring"):
            figures = (one.cores, one.ratio, one.rate_hz, *(one.latency_ms or (None, None)))
            texts = ("–" if figure is None else f"{figure:.3g}" for figure in figures)
            table.add_row(f"{one.imu_rate_hz or 'at rest'}", one.node, *texts)
    Terminal().print(table)


def _print(rows: list[dict[str, Any]]) -> None:
    from rich.table import Table

    from uav_vslam.report.terminal import Terminal

    table = Table("Stage", "Condition")
    for heading in ("Time", "Ratio to"):
        table.add_column(heading, justify="right")
    table.add_column("Reference")
    for row in rows:
        reference = "\n".join([row["reference"], *_figures(row, "gtsam_")])
        table.add_row(
            row["method"], row["condition"], "\n".join(_figures(row)), f"{row['ratio_to_reference']:.3g}", reference
        )
    Terminal().print(table)


def _figures(row: dict[str, Any], whose: str = "") -> list[str]:
    forms = {
        "ms_per_frame": "{:.3g} ms/frame",
        "ms_per_packet": "{:.3g} ms/packet",
        "us_per_landmark": "{:.3g} µs/landmark",
        "mb_per_s": "{:.3g} MB/s",
        "end_rms_m": "end {:.3g} m",
        "ate_rms_m": "ATE {:.3g} m",
    }
    return [form.format(row[whose + key]) for key, form in forms.items() if whose + key in row]
