# SPDX-License-Identifier: Apache-2.0
"""All that `uav-vslam bench` measures."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2

from uav_vslam.evaluation.study import Row
from uav_vslam.slam.packet import ANCHOR, PacketPolicy
from uav_vslam.studies.bench import back_end, matching, stages
from uav_vslam.studies.bench.recordings import recordings
from uav_vslam.vision.compact_descriptors import COMPACT


@dataclass(frozen=True, slots=True)
class Effort:
    """How thoroughly to measure.

    Attributes:
        pairs: image pairs.
        frames: frames of the back end, after its warm-up.
        repeats: of everything that takes a few milliseconds or less.
    """

    pairs: int = 31
    frames: int = 95
    repeats: int = 100


QUICK = Effort(pairs=2, frames=3, repeats=3)


def measure(effort: Effort) -> Iterator[Row]:
    """Yield a row per stage and condition."""
    vehicle, frames = stages.rendered_frames(effort.pairs)
    few = frames[:8]  # enough where each frame is measured by itself
    yield stages.stereo_front_end(vehicle, few, _sift())
    yield stages.live_front_end(vehicle, frames, _sift())
    yield from matching.graph_matching(2000, min(effort.repeats, 10))
    for landmarks in (50, 100, 200, 400):
        yield back_end.back_end(landmarks, effort.frames)
    yield back_end.back_end(200, effort.frames, lag_s=back_end.TRACK_LAG_S)
    yield back_end.back_end(200, effort.frames // 3, factorisation=back_end.QR)
    for shared in (10, 50, 200):
        yield stages.fusion(shared, min(effort.repeats, 30))
    for shared in (10, 50, 200):
        yield stages.weight_search(shared, min(effort.repeats, 10))
    yield from stages.packets(64, PacketPolicy(), effort.repeats)
    yield from stages.packets(22, PacketPolicy(form=ANCHOR, descriptor_basis=COMPACT), effort.repeats)
    yield stages.preintegration(effort.repeats)
    yield from recordings(vehicle, frames, repeats=min(effort.repeats, 10))


def _sift() -> Callable[[Any], object]:
    detector = cv2.SIFT_create()
    return lambda image: detector.detectAndCompute(image, None)
