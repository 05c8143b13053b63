# SPDX-License-Identifier: Apache-2.0
"""An inspection as text of at most 100 columns, and as a tree for JSON."""

import dataclasses
import math
import textwrap
from typing import Any

from uav_vslam.datasets.survey import Stream, Survey
from uav_vslam.inspection import timing
from uav_vslam.inspection.finding import Finding, Severity, count
from uav_vslam.inspection.recording import Inspection
from uav_vslam.inspection.stereo_stamps import OffsetHistogram
from uav_vslam.types import NS_PER_S

WIDTH = 100
BARS = " ▁▂▃▄▅▆▇█"
LABEL = {Severity.ERROR: "ERROR", Severity.WARNING: "warning", Severity.OK: "ok"}
INDENT = 10
HINT = 9  # columns of "allowed"


def text(survey: Survey, inspection: Inspection) -> str:
    """Return the report on one vehicle."""
    errors, warnings = (count(inspection.findings, one) for one in (Severity.ERROR, Severity.WARNING))
    verdict = "the graph can run" if inspection.usable else "the graph can't run"
    lines = [
        f"{inspection.vehicle}: {verdict}: {_number(errors, 'error')}, {_number(warnings, 'warning')}; "
        f"{timing.span_text(survey.streams)}",
        "",
        *_table(survey),
        "",
    ]
    for severity in Severity:
        for finding in inspection.findings:
            if finding.severity is severity:
                lines += _entry(finding)
    if inspection.offsets is not None and inspection.offsets.spread_s > 0:
        lines += _bars(inspection.offsets)
    if inspection.block:
        named = f" --vehicles {inspection.block_of}" if inspection.block_of else ""
        lines += ["", f"  To put into a configuration (--config FILE{named}):", ""]
        lines += textwrap.indent(inspection.block, "    ").splitlines()
    return "\n".join(lines)


def tree(survey: Survey, inspection: Inspection) -> dict[str, Any]:
    """Return the report on one vehicle as plain data, for JSON."""
    return {
        "vehicle": inspection.vehicle,
        "usable": inspection.usable,
        "errors": count(inspection.findings, Severity.ERROR),
        "warnings": count(inspection.findings, Severity.WARNING),
        "findings": [dataclasses.asdict(one) | {"severity": one.severity.value} for one in inspection.findings],
        "topics": [
            {"role": role, "topic": one.topic, "type": one.msgtype, "messages": len(one), "rate_hz": _rate_hz(one)}
            for role, one in survey.streams.items()
        ],
        "stereo_offsets": None if inspection.offsets is None else dataclasses.asdict(inspection.offsets),
        "imu_noise": {sensor: dataclasses.asdict(level) for sensor, level in inspection.noise.items()},
        "configuration": inspection.block,
    }


def _table(survey: Survey) -> list[str]:
    rows = [
        (
            role,
            one.topic,
            one.msgtype.rsplit("/", 1)[-1],
            str(len(one)),
            f"{rate:.2f} Hz" if (rate := _rate_hz(one)) else "",
        )
        for role, one in survey.streams.items()
    ]
    rows = [("", "topic", "type", "messages", "rate"), *rows]
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return [
        f"  {row[0]:<{widths[0]}}  {row[1]:<{widths[1]}}  {row[2]:<{widths[2]}}  {row[3]:>{widths[3]}}  "
        f"{row[4]:>{widths[4]}}".rstrip()
        for row in rows
    ]


def _rate_hz(stream: Stream) -> float | None:
    return None if math.isnan(stream.period_ns) else NS_PER_S / stream.period_ns


def _entry(finding: Finding) -> list[str]:
    head = f"  {LABEL[finding.severity]:<{INDENT - 2}}"
    if finding.severity is Severity.OK:
        return _wrapped(f"{finding.subject}: {finding.seen}", head, " " * INDENT)
    parts = (("seen", finding.seen), ("allowed", finding.allowed), ("do", finding.remedy))
    lines = [f"{head}{finding.subject}"]
    for name, said in parts:
        lines += _wrapped(said, f"{'':{INDENT}}{name:<{HINT}}", " " * (INDENT + HINT))
    return lines


def _wrapped(said: str, first: str, rest: str) -> list[str]:
    options: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    return textwrap.wrap(said, WIDTH, initial_indent=first, subsequent_indent=rest, **options)


def _bars(shape: OffsetHistogram) -> list[str]:
    most = max(shape.counts)
    bars = "".join(BARS[-(-(len(BARS) - 1) * one // most)] for one in shape.counts)
    edges = [f"{1e3 * shape.edges_s[k]:.3g} ms" for k in (0, -1)]
    return ["", f"  right minus left stamp: {edges[0]} |{bars}| {edges[1]}"]


def _number(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
