# SPDX-License-Identifier: Apache-2.0
"""What every importer yields, and how it becomes a bag and a configuration to run it.

The bag is written into OUT.partial and moved to OUT when it is complete, so that OUT is a whole recording or does not
exist. An import that was cut short starts again.
"""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from uav_vslam.config import difference_file, find_config, load_vehicle, replaced
from uav_vslam.datasets.flight_writer import FlightRecording, write_flights
from uav_vslam.errors import BagError

PARTIAL = ".partial"
IN_FLIGHT = {"start.method": "in_flight"}  # settings of a recording without ground truth


@dataclass(frozen=True, slots=True)
class Source:
    """A data set that can be recorded.

    Attributes:
        flight: its streams; they are read while they are written.
        frame_count: image pairs, at most.
        base: name of one of our configurations that suits it; empty for the defaults.
        settings: what differs from that, by dotted name.
        notes: what the user should know.
        warnings: what in it contradicts itself.
        runnable: whether the graph can run it; None for no configuration otherwise.
    """

    flight: FlightRecording
    frame_count: int
    base: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    runnable: bool = True


def require_new(out: Path) -> bool:
    """Prepare for writing: remove what an import that was cut short has left.

    Returns:
        Whether there was any.

    Raises:
        BagError: `out` exists, or something else has its place.
    """
    if out.exists():
        raise BagError(f"{out} exists already; remove it to import again, or choose another name")
    partial = _partial(out)
    if not partial.exists():
        return False
    if not partial.is_dir() or {path.name for path in partial.iterdir()} - {out.name}:
        raise BagError(f"{partial} holds other things than an unfinished import; remove or rename it")
    shutil.rmtree(partial)
    return True


def write_source(
    source: Source, out: Path, *, storage: str = "mcap", zstd: bool = False, on_frame: Callable[[], None] | None = None
) -> Path | None:
    """Record a data set, and write OUT.yaml unless it is there.

    Args:
        source: the data set.
        out: bag folder to make.
        storage: "mcap" or "sqlite3".
        zstd: compress the chunks of an mcap file.
        on_frame: called after each image pair, for a progress bar.

    Returns:
        The configuration file, None if the graph can't run the recording.

    Raises:
        BagError: `out` exists or can't be made.
    """
    partial = _partial(out)
    try:
        partial.mkdir(parents=True)
    except OSError as error:
        raise BagError(f"{partial}: can't be made ({error.strerror}); choose another place") from None
    try:
        write_flights(partial / out.name, [source.flight], storage=storage, zstd=zstd, on_frame=on_frame)
        (partial / out.name).rename(out)
    finally:
        shutil.rmtree(partial)
    return write_configuration(source, out) if source.runnable else None


def write_configuration(source: Source, out: Path) -> Path:
    """Write OUT.yaml, a parameter file for `uav-vslam run OUT --config OUT.yaml`; one that is there is kept."""
    path = out.with_name(f"{out.name}.yaml")
    if not path.exists():
        base = load_vehicle(find_config(source.base) if source.base else None)
        config = replaced(base, dict(source.settings), where=str(path))
        path.write_text(yaml.safe_dump(difference_file(config), sort_keys=False), encoding="utf-8")
    return path


def _partial(out: Path) -> Path:
    return out.with_name(out.name + PARTIAL)
