# SPDX-License-Identifier: Apache-2.0
"""Every matcher on pairs of rendered images against the true ground points: section 6.3.5 of [thesis]."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.studies.engine.association_stages import Score
from uav_vslam.studies.engine.extracted_flights import ExtractedFlight, ground_points, shown_at
from uav_vslam.studies.engine.pool import grouped, median
from uav_vslam.vision.features import Keypoints
from uav_vslam.vision.matching import MATCHERS

Array = NDArray[np.float64]

EVERY = 10  # frames from one evaluated image to the next
LATER = 5  # frames to the second image of a pair in time
IN_IMAGES = "Matching of two images"

IMAGE_NOTES = {
    "Images": f"left and right: of every {EVERY}th frame; in time: its left image and that of "
    f"{LATER} frames later, 0.7 s or 14 m. Up to 1000 SIFT keypoints each. Precision: the matched keypoint is within "
    "4 px of the true position of the first one's ground point; recall: of the keypoints whose point the other image "
    "also has a keypoint of",
}


@dataclass(frozen=True, slots=True)
class View:
    """One image of a pair.

    Attributes:
        keypoints: as the extractor found them.
        pixels: (N, 2) theirs, undistorted and at full resolution [px].
        T_world_cam: true pose.
        camera: its lens.
    """

    keypoints: Keypoints
    pixels: Array
    T_world_cam: Pose
    camera: PinholeCamera


@dataclass(frozen=True, slots=True)
class MatcherScore:
    """A matcher's result on two images, and its time [ms]."""

    condition: str
    kind: str
    matcher: str
    score: Score
    ms: float


def kept_frames(frames: int) -> set[int]:
    """Return the frames whose keypoints the comparison needs."""
    first = range(0, frames - LATER, EVERY)
    return {*first, *(frame + LATER for frame in first)}


def image_pairs(flight: ExtractedFlight) -> Iterator[tuple[str, View, View]]:
    """Yield what kind of pair it is and both views."""
    rig, T_left_right = flight.rig, flight.rig.T_right_left.inverse()
    for frame in range(0, len(flight.steps) - LATER, EVERY):
        pair, T_world_left = flight.pairs[frame], flight.T_world_left[frame]
        later, T_world_later = flight.pairs[frame + LATER], flight.T_world_left[frame + LATER]
        left = View(pair.left, pair.pixels_left, T_world_left, rig.left)
        yield "left and right", left, View(pair.right, pair.pixels_right, T_world_left @ T_left_right, rig.right)
        yield "in time", left, View(later.left, later.pixels_left, T_world_later, rig.left)


def score_matchers(flight: ExtractedFlight, *, ratio: float) -> list[MatcherScore]:
    """Try every matcher on every pair of images of a rendered flight."""
    found = []
    for kind, a, b in image_pairs(flight):
        right = _same_points(flight, a, b)
        for name, match in MATCHERS.items():
            started_ns = time.process_time_ns()
            matches = match(a.keypoints, b.keypoints, ratio)
            ms = 1e-6 * (time.process_time_ns() - started_ns)
            good = int(right[matches[:, 0], matches[:, 1]].sum())
            score = Score(len(matches), good, good, int(right.any(axis=1).sum()))
            found.append(MatcherScore(flight.condition, kind, name, score, ms))
    return found


def _same_points(flight: ExtractedFlight, a: View, b: View) -> NDArray[np.bool_]:
    """Return (Na, Nb), which keypoints of two views show the same point of the ground."""
    assert flight.relief is not None
    points = ground_points(flight.relief, a.T_world_cam, a.camera, a.pixels)
    off_px = np.linalg.norm(shown_at(b.T_world_cam, b.camera, points)[:, None] - b.pixels, axis=2)
    return np.asarray(off_px <= flight.tolerance_px)


def image_rows(matched: Sequence[MatcherScore]) -> list[Row]:
    """Return a row per condition, kind of pair and matcher."""
    rows = []
    for (condition, kind, name), chosen in grouped(matched, lambda j: (j.condition, j.kind, j.matcher)).items():
        score = sum((j.score for j in chosen), Score())
        rows.append(
            {
                TABLE: IN_IMAGES,
                "method": name,
                "condition": f"{condition}, {kind}",
                "matches": score.left / len(chosen),
                **score.row(),
                "ms_per_pair": median([j.ms for j in chosen]),
            }
        )
    return rows
