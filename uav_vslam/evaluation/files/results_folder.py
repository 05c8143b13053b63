# SPDX-License-Identifier: Apache-2.0
"""Reads the trajectories of a results folder back, as `output.write_results` wrote them."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.evaluation.files.reading import read_trajectory
from uav_vslam.evaluation.output import ALL_TRACKS
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import Trajectory, interpolate

NAME = re.compile(rf"(?P<vehicle>.+)_(?P<track>{'|'.join(ALL_TRACKS)})\.tum")
DATE = re.compile(r"\d{4}-\d\d-\d\d_\d{6}_(?=.)")

Tracks = dict[str, Trajectory]


def read_results(folder: Path) -> dict[str, Tracks]:
    """Return the tracks that have poses, by vehicle and by name (`output.ALL_TRACKS`).

    Raises:
        TrajectoryFileError: the folder holds no trajectory of a flight.
    """
    found: dict[str, Tracks] = {}
    for path in sorted(folder.glob("*.tum")):
        name = NAME.fullmatch(path.name)
        if name is not None and path.stat().st_size > 0:
            with_covariance = path.with_suffix(".csv")
            source = with_covariance if with_covariance.exists() else path
            found.setdefault(name["vehicle"], {})[name["track"]] = read_trajectory(source)
    if not found:
        raise TrajectoryFileError(
            f"{folder} holds no trajectories such as uav1_s_slam.tum; name a folder that run or demo wrote, or the "
            "trajectory files themselves"
        )
    return {
        vehicle: {track: tracks[track] for track in ALL_TRACKS if track in tracks} for vehicle, tracks in found.items()
    }


def at_equal_stamps(tracks: Tracks) -> Tracks:
    """Return the estimates without the truth, all at the stamps of the own-only track as `summary.json` scores them."""
    estimates = {name: track for name, track in tracks.items() if name != "truth"}
    if "s_slam" not in estimates:
        return estimates
    stamps_ns = estimates["s_slam"].stamps_ns
    if "ins" in estimates:
        estimates["ins"], _ = interpolate(estimates["ins"], stamps_ns, max_gap_s=MAX_GAP_S)
    if "c_slam" in estimates:
        estimates["c_slam"] = estimates["c_slam"].select(np.isin(estimates["c_slam"].stamps_ns, stamps_ns))
    return {name: track for name, track in estimates.items() if len(track)}


def short_name(folder: Path) -> str:
    """Return the name of a results folder without its date."""
    return DATE.sub("", folder.resolve().name)


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """Return a name of each file or folder: without ending or date, else in full, else numbered."""
    short = [short_name(path) if path.is_dir() else path.stem for path in paths]
    full = [path.resolve().name if path.is_dir() else f"{path.parent.name}/{path.name}" for path in paths]
    numbered = [f"{number} {name}" for number, name in enumerate(short, 1)]
    return next((names for names in (short, full) if len(set(names)) == len(names)), numbered)
