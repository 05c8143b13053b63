# SPDX-License-Identifier: Apache-2.0
"""What to draw on the left image of a frame: its points, those that corrected the state, and where they came from."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.types import NS_PER_S, StereoFeatures

Array = NDArray[np.float64]

TRAIL_FRAMES = 3  # before it: more would hide the image


@dataclass(frozen=True, slots=True)
class TrackOverlay:
    """The points of one frame, in pixels of the recorded left image.

    Attributes:
        stamp_ns: of the frame [ns].
        points: (N, 2) of all features [px].
        associated: (N,) whether a point corrected the state.
        trails: (K, 2) each, K > 1: positions of a point over the last frames, oldest first [px].
        caption: time and counts.
        coasted: the frame had no visual update.
    """

    stamp_ns: int
    points: Array
    associated: NDArray[np.bool_]
    trails: list[Array]
    caption: str
    coasted: bool


@dataclass(frozen=True, slots=True)
class _Points:
    """Points of a frame: raw pixels (N, 2), identity over frames (N,), 0 for none, and whether they are associated."""

    pixels: Array
    labels: NDArray[np.int64]
    associated: NDArray[np.bool_]


def evenly(count: int, frames: int) -> NDArray[np.intp]:
    """Return up to `count` of the frames 0 to frames - 1, evenly through the flight, first and last included."""
    return np.unique(np.linspace(0, max(frames - 1, 0), min(count, frames)).round().astype(np.intp))


def overlays(track: VehicleTrack, camera: PinholeCamera, rows: Iterable[int]) -> Iterator[TrackOverlay]:
    """Yield the overlays of some frames.

    Args:
        track: flown with `keep_features`.
        camera: the left one.
        rows: of `track.outputs`, ascending.
    """
    known: dict[int, _Points] = {}
    start_ns = track.outputs[0].report.pose.stamp_ns if track.outputs else 0
    for row in rows:
        window = range(max(0, row - TRAIL_FRAMES), row + 1)
        known = {k: known.get(k) or _points(track.outputs[k], track.features, camera) for k in window}
        output, points = track.outputs[row], known[row]
        seconds = (output.report.pose.stamp_ns - start_ns) / NS_PER_S
        counts = f"{points.associated.sum()} of {len(points.pixels)} points associated"
        yield TrackOverlay(
            stamp_ns=output.report.pose.stamp_ns,
            points=points.pixels,
            associated=points.associated,
            trails=_trails([known[k] for k in window]),
            caption=f"{seconds:.2f} s: {'coasted' if output.report.coasted else counts}",
            coasted=output.report.coasted,
        )


def _points(output: FrameOutput, features: Mapping[int, StereoFeatures], camera: PinholeCamera) -> _Points:
    """Return a frame's points; they are known by their feature track, without tracking by their landmark."""
    report = output.report
    found = features.get(report.pose.stamp_ns, StereoFeatures.empty(report.pose.stamp_ns))
    labels, associated = found.tracks.astype(np.int64), np.zeros(len(found), bool)
    associated[report.sightings[: report.associated, 1]] = True
    if not labels.any():
        labels[report.sightings[:, 1]] = report.sightings[:, 0] + 1
    return _Points(camera.distort(found.pixels[:, :2].astype(float)), labels, associated)


def _trails(window: list[_Points]) -> list[Array]:
    """Return the past positions of the last frame's points, back to the first frame that lacks the point."""
    trails = {int(label): [pixel] for label, pixel in zip(window[-1].labels, window[-1].pixels, strict=True) if label}
    alive = set(trails)
    for points in reversed(window[:-1]):
        here = {int(label): pixel for label, pixel in zip(points.labels, points.pixels, strict=True)}
        alive &= here.keys()
        for label in alive:
            trails[label].append(here[label])
    return [np.array(trail[::-1]) for trail in trails.values() if len(trail) > 1]
