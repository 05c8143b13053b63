# SPDX-License-Identifier: Apache-2.0
"""The results folder: `results/<date>_<name>/`, and the link `results/latest` to the newest complete one."""

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.files.writing import write_csv, write_json, write_tum
from uav_vslam.evaluation.flight_tables import write_landmarks, write_link, write_timing
from uav_vslam.evaluation.frame_table import write_frames
from uav_vslam.evaluation.result import FlightResult
from uav_vslam.evaluation.revision import git_revision
from uav_vslam.evaluation.study import study_markdown
from uav_vslam.evaluation.summary import TRACKS, build_summary

Plotter = Callable[[FlightResult, Path], list[Path]]
StudyPlotter = Callable[[dict[str, Any], Path], list[Path]]
FolderPlotter = Callable[[Path], Path]

SUMMARY, CONFIG, STUDY = "summary.json", "config.yaml", "study.json"
LATEST = "latest"
NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS)  # of FAT, of a network, of FUSE
ALL_TRACKS = ("truth", *TRACKS)
WITH_COVARIANCE = ("s_slam", "c_slam", "smoothed")  # for NEES, which TUM has no place for


def write_results(result: FlightResult, root: Path, *, plot: Plotter | None = None, alignment: str = "none") -> Path:
    """Write summary, trajectories, records of the frames, configuration and plots of a flight into a new folder.

    Args:
        result: the flight.
        root: folder of all results.
        plot: draws into the folder, `report.plots.write_plots`; None draws nothing.
        alignment: of the estimates to the ground truth, see `evaluation.alignment`.

    Returns:
        The new folder.
    """
    with new_folder(root, result.name) as folder:
        write_json(folder / SUMMARY, build_summary(result, git=git_revision(), alignment=alignment))
        config = yaml.safe_dump(result.config, sort_keys=False)
        (folder / CONFIG).write_text(config, encoding="utf-8")
        _write_vehicles(result, folder)
        if plot is not None:
            plot(result, folder)
    return folder


def write_study(tree: dict[str, Any], root: Path, *, plot: StudyPlotter | None = None) -> Path:
    """Write `study.json`, the tables `study.md` and the plots of a comparison of methods into a new folder.

    Args:
        tree: from `study.study_tree`.
        root: folder of all results.
        plot: draws the tree into the folder; None draws nothing.

    Returns:
        The new folder.
    """
    with new_folder(root, tree["study"]) as folder:
        write_json(folder / STUDY, tree)
        (folder / "study.md").write_text(study_markdown(tree), encoding="utf-8")
        if plot is not None:
            plot(tree, folder)
    return folder


def write_comparison(tree: dict[str, Any], root: Path, *, plot: FolderPlotter | None) -> Path:
    """Write `comparison.json` and the plot into a new folder; `latest`, which may be compared, stays where it is.

    Args:
        tree: from `comparison.compare`.
        root: folder of all results.
        plot: draws into the folder; None draws nothing.

    Returns:
        The new folder.
    """
    with _dated_folder(root, tree["comparison"]) as folder:
        write_json(folder / "comparison.json", tree)
        if plot is not None:
            plot(folder)
    return folder


def latest_link(root: Path) -> Path:
    """Return the path of the link to the newest results.

    Raises:
        UavVslamError: the path exists and is not a link.
    """
    latest = root / LATEST
    if latest.exists() and not latest.is_symlink():
        raise UavVslamError(f"{latest} is not a symbolic link, so it can't be updated; move it away")
    return latest


@contextmanager
def new_folder(root: Path, name: str) -> Iterator[Path]:
    """Yield a new dated folder; once it is filled, `latest` is linked to it, where the file system has links."""
    latest = latest_link(root)
    with _dated_folder(root, name) as folder:
        yield folder
    # Only renaming another link over it replaces a link atomically.
    fresh = root / f".{LATEST}_{os.getpid()}"
    fresh.unlink(missing_ok=True)
    try:
        fresh.symlink_to(folder.name)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        return
    fresh.replace(latest)


@contextmanager
def _dated_folder(root: Path, name: str) -> Iterator[Path]:
    """Yield a new folder; if it can't be filled, it gets another name, so that nobody takes it for a result."""
    folder = _make_unique(root, f"{datetime.now():%Y-%m-%d_%H%M%S}_{_file_name(name)}")
    try:
        yield folder
    except BaseException as error:
        incomplete = folder.rename(f"{folder}.incomplete")
        if isinstance(error, OSError):  # of a write, which knows no name or the folder's former one
            error.filename = str(error.filename or folder).replace(str(folder), str(incomplete))
        raise


def _make_unique(root: Path, stem: str) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    for attempt in range(1, 1000):
        folder = root / (stem if attempt == 1 else f"{stem}_{attempt}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise UavVslamError(f"{root} holds 1000 results named {stem}; remove some")


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "unnamed"


def _write_vehicles(result: FlightResult, folder: Path) -> None:
    for name, vehicle in result.vehicles.items():
        for track in ALL_TRACKS:
            trajectory = getattr(vehicle, track)
            if trajectory is not None:
                write_tum(trajectory, folder / f"{name}_{track}.tum")
            if trajectory is not None and track in WITH_COVARIANCE:
                write_csv(trajectory, folder / f"{name}_{track}.csv")
        if vehicle.frames is not None:
            write_frames(vehicle, folder / f"{name}_frames.csv")
        if vehicle.epochs:
            write_link(vehicle.epochs, folder / f"{name}_link.csv", start_ns=vehicle.start_ns)
        if any(vehicle.stage_s.values()):
            write_timing(vehicle.stage_s, folder / f"{name}_timing.csv", start_ns=vehicle.start_ns)
        if vehicle.landmarks is not None:
            write_landmarks(vehicle.landmarks, folder / f"{name}_landmarks.csv")
