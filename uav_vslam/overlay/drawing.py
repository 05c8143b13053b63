# SPDX-License-Identifier: Apache-2.0
"""Draws an overlay on its image, and a flight's images as a video."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import UavVslamError
from uav_vslam.overlay.tracks import TrackOverlay
from uav_vslam.vision.images import to_grey8

Image = NDArray[np.uint8]

ASSOCIATED, OTHER, TRAIL, WARNING = (90, 220, 60), (40, 160, 255), (240, 200, 60), (40, 40, 230)  # BGR
POINT_PER_WIDTH = 1 / 160  # radius of a point
TEXT_PER_WIDTH = 1 / 800  # OpenCV's font scale
CODEC, SUFFIX = "mp4v", ".mp4"


def drawn(image: NDArray[np.generic], overlay: TrackOverlay) -> Image:
    """Return the image in grey with points and trails in colour, (H, W, 3) BGR.

    Args:
        image: (H, W) grey or (H, W, 3) BGR, uint8 or uint16.
        overlay: in its pixels.

    Raises:
        InvalidMessage: an image of another shape or type.
    """
    canvas = cv2.cvtColor(to_grey8(image), cv2.COLOR_GRAY2BGR)
    radius = max(1, round(canvas.shape[1] * POINT_PER_WIDTH))
    trails = [np.rint(trail).astype(np.int32) for trail in overlay.trails]
    cv2.polylines(canvas, trails, isClosed=False, color=TRAIL, thickness=1, lineType=cv2.LINE_AA)
    for point, associated in zip(np.rint(overlay.points).astype(int).tolist(), overlay.associated, strict=True):
        cv2.circle(canvas, point, radius, ASSOCIATED if associated else OTHER, -1 if associated else 1, cv2.LINE_AA)
    return np.asarray(canvas, np.uint8)


def captioned(canvas: Image, overlay: TrackOverlay) -> Image:
    """Return a drawn image with its caption at the top left."""
    marked, scale = canvas.copy(), max(0.4, canvas.shape[1] * TEXT_PER_WIDTH)
    at = (round(12 * scale), round(34 * scale))
    colour = WARNING if overlay.coasted else (255, 255, 255)
    for ink, thickness in (((0, 0, 0), 4), (colour, 1)):
        width = max(1, round(thickness * scale))
        cv2.putText(marked, overlay.caption, at, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, width, cv2.LINE_AA)
    return marked


def write_video(path: Path, images: Iterable[Image], frame_rate_hz: float) -> Path:
    """Write images of one size as MPEG-4.

    Raises:
        UavVslamError: OpenCV can't write the file.
    """
    writer = None
    try:
        for image in images:
            if writer is None:
                fourcc = cv2.VideoWriter.fourcc(*CODEC)
                writer = cv2.VideoWriter(str(path), fourcc, frame_rate_hz, (image.shape[1], image.shape[0]))
                if not writer.isOpened():
                    raise UavVslamError(f"{path}: OpenCV can't write {CODEC} video here; run without --video")
            writer.write(image)
    finally:
        if writer is not None:
            writer.release()
    return path
