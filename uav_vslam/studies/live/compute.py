# SPDX-License-Identifier: Apache-2.0
"""A node graph in real time: the share of frames processed, and each process's share of a core."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.processes import processor_time_s

PROC = Path("/proc")

NOTES = {
    "Frames": "processed_share: frames for which the graph published an own-only pose, of those that were played",
    "Processor": "share of one core, user and system, over the time of the flight: not over the start of the processes",
}


@dataclass(frozen=True, slots=True)
class Sample:
    """What the processes have used up to a time.

    Attributes:
        time_s: of a steady clock [s].
        cpu_s: processor time of each process by its name [s].
    """

    time_s: float
    cpu_s: Mapping[str, float]


def sample_children(parent: int, time_s: float) -> Sample:
    """Return what the child processes of a launcher have used so far; ending processes are left out."""
    found: dict[str, float] = {}
    for pid, words in child_commands(parent).items():
        name = node_name(words)
        if not name:
            continue
        with suppress(OSError):
            found[name] = found.get(name, 0.0) + processor_time_s(pid)
    return Sample(time_s, found)


def child_commands(parent: int) -> dict[int, list[str]]:
    """Return the words of the command line of each child process; ending processes are left out."""
    found: dict[int, list[str]] = {}
    for entry in (PROC / str(parent) / "task" / str(parent) / "children").read_text(encoding="ascii").split():
        with suppress(OSError):
            found[int(entry)] = (PROC / entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
    return found


def node_name(words: Sequence[str]) -> str:
    """Return "uav1/slam_backend" for the command line of a node; empty for any other."""
    parts = {key: word.removeprefix(key) for key in ("__ns:=", "__node:=") for word in words if word.startswith(key)}
    return f"{parts['__ns:=']}/{parts['__node:=']}".strip("/") if len(parts) == 2 else ""


def processor_rows(samples: Sequence[Sample], leader: str, duration_s: float, condition: str) -> list[Row]:
    """Return each process's share of a core over the flight, which ends with the leading process, and the sum."""
    flown = [sample for sample in samples if leader in sample.cpu_s]
    if not flown:
        return []
    last = flown[-1]
    first = next(sample for sample in flown if sample.time_s >= last.time_s - duration_s)
    elapsed_s = max(last.time_s - first.time_s, 1e-9)
    shares = {name: (cpu_s - first.cpu_s.get(name, 0.0)) / elapsed_s for name, cpu_s in sorted(last.cpu_s.items())}
    shares["all"] = sum(shares.values())
    return [
        {TABLE: "Processor", "method": name, "condition": condition, "core_share": share}
        for name, share in shares.items()
    ]


def frame_rows(processed: Mapping[str, int], played: int, condition: str) -> list[Row]:
    """Return the share of the frames that each vehicle's graph kept up with."""
    return [
        {TABLE: "Frames", "method": name, "condition": condition, "frames": played, "processed_share": count / played}
        for name, count in processed.items()
    ]
