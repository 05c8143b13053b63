# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam study`: methods compared over many runs. Each study is a folder of `uav_vslam.studies`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from uav_vslam.argument_types import non_negative, positive
from uav_vslam.cli.arguments import add_results
from uav_vslam.cli.overrides import overrides
from uav_vslam.cli.progress import progress_bar
from uav_vslam.studies.registry import STUDIES

if TYPE_CHECKING:
    from uav_vslam.studies.engine.study import Findings, Study

HELP = "compare methods over many flights"
EXAMPLES = """examples:
  uav-vslam study models --seeds 20                   seeds 1 to 20
  uav-vslam study models --seeds 20 --first-seed 1001
  uav-vslam study STUDY --help                        arguments and examples of one study
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the studies."""
    studies = parser.add_subparsers(title="studies", metavar="STUDY", required=True)
    for name, study in STUDIES.items():
        subparser = studies.add_parser(
            name,
            help=f"{study.help}; {study.takes}",
            description=f"{study.help[:1].upper()}{study.help[1:]}. By default it takes {study.takes}.",
            epilog=study.examples,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        study.add_arguments(subparser)
        _add_common(subparser, study)
        subparser.set_defaults(study=name)


def _add_common(parser: argparse.ArgumentParser, study: Study) -> None:
    """Declare what studies share."""
    if study.frames:
        text = f"frames of each flight (default {study.frames})"
        parser.add_argument("--frames", type=positive, default=study.frames, help=text)
    if study.scaled:
        parser.add_argument("--scale", type=float, default=1.0, help="image size over 1280 x 960 (default 1)")
    if study.variants:
        parser.add_argument(
            "--variant",
            action="append",
            default=[],
            metavar="KEY=VALUE[,KEY=VALUE...]",
            help=f"settings to compare; may be repeated for others (default: {study.variants})",
        )
    if study.settings:
        parser.add_argument(
            "--set", action="append", default=[], metavar="KEY=VALUE", help="override one setting; may be repeated"
        )
    parser.add_argument(
        "--seeds",
        type=non_negative if study.seedless else positive,
        default=study.seeds,
        metavar="N",
        help=f"how many (default {study.seeds})",
    )
    parser.add_argument("--first-seed", type=non_negative, default=1, metavar="K", help="the first of them (default 1)")
    if study.workers:
        parser.add_argument(
            "--workers", type=positive, default=study.workers, help=f"processes (default {study.workers})"
        )
    add_results(parser)


def run(args: argparse.Namespace) -> int:
    """Run the chosen study; print its tables, write and draw them."""
    study, seeds = STUDIES[args.study], seeds_of(args)
    if study.variants:
        args.variant = {text: overrides(text.split(",")) for text in args.variant}
    if study.settings:
        args.set = overrides(args.set)
    with ExitStack() as shown:

        def progress(total: int, title: str = f"study {args.study}") -> Callable[..., None]:
            shown.close()
            return shown.enter_context(progress_bar(title, total))

        findings = study.run(args, seeds, progress)
    publish(f"study_{args.study}", findings, seeds, args)
    return 0


def seeds_of(args: argparse.Namespace) -> list[int]:
    """Return the seeds asked for."""
    return list(range(args.first_seed, args.first_seed + args.seeds))


def publish(name: str, findings: Findings, seeds: list[int], args: argparse.Namespace) -> None:
    """Print the tables, write them and the plots into a new folder below the results, and say where they are."""
    from uav_vslam.evaluation.output import write_study
    from uav_vslam.evaluation.study import study_markdown, study_tree
    from uav_vslam.report.page.page import write_page
    from uav_vslam.studies.engine.columns import legend

    rows = findings.rows
    notes = {"Columns": legend(rows), **findings.notes}
    tree = study_tree(name, rows, seeds, notes=notes, series=findings.series)
    print(study_markdown(tree))
    folder = write_study(tree, args.results, plot=findings.draw)
    print(f"results: {folder}")
    print(f"page: {write_page([folder])}")
