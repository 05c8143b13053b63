# SPDX-License-Identifier: Apache-2.0
"""What every importer yields, and how it becomes a bag and a configuration to run it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from uav_vslam.config import difference_file, find_config, load_vehicle, replaced
from uav_vslam.datasets.flight_writer import FlightRecording, write_flights
from uav_vslam.datasets.unfinished import unfinished
from uav_vslam.errors import BagError

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


def write_source(
    source: Source, out: Path, *, storage: str = "mcap", zstd: bool = False, on_frame: Callable[[], None] = lambda: None
) -> tuple[int, Path | None]:
    """Record a data set, and write OUT.yaml unless it is there.

    A data set of which no image pair can be read makes no recording.

    Args:
        source: the data set.
        out: bag folder to make.
        storage: "mcap" or "sqlite3".
        zstd: compress the chunks of an mcap file.
        on_frame: called after each image pair, for a progress bar.

    Returns:
        How many image pairs were recorded, and the configuration file, None if the graph can't run the recording.

    Raises:
        BagError: `out` exists or can't be made, or no image pair can be read.
    """
    with unfinished(out) as folder:
        written = write_flights(folder, [source.flight], storage=storage, zstd=zstd, on_frame=on_frame)
        if not written:
            raise BagError(f"{out}: not made, as none of {source.frame_count} image pairs can be read")
    return written, (write_configuration(source, out) if source.runnable else None)


def configuration_file(out: Path) -> Path:
    """Return OUT.yaml, which is absent or a file.

    Raises:
        BagError: something else has its place.
    """
    path = out.with_name(f"{out.name}.yaml")
    if path.exists() and not path.is_file():
        raise BagError(f"{path}: is no file, and the configuration is written there; remove it, or choose another OUT")
    return path


def write_configuration(source: Source, out: Path) -> Path:
    """Write OUT.yaml, a parameter file for `uav-vslam run OUT --config OUT.yaml`; one that is there is kept."""
    path = configuration_file(out)
    if not path.exists():
        base = load_vehicle(find_config(source.base) if source.base else None)
        config = replaced(base, dict(source.settings), where=str(path))
        path.write_text(yaml.safe_dump(difference_file(config), sort_keys=False), encoding="utf-8")
    return path
