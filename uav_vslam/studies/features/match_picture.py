# SPDX-License-Identifier: Apache-2.0
"""Two images side by side with their matches, without and with RANSAC."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uav_vslam.report.style import save

KEPT, REMOVED = "#ffd400", "#ff3b30"
MOST_LINES = 400
Image = NDArray[np.generic]


def match_picture(
    images: tuple[Image, Image],
    pixels: tuple[NDArray[np.floating], NDArray[np.floating]],
    kept: NDArray[np.bool_],
    title: str,
) -> Figure:
    """Return the picture: all matches above, those that RANSAC keeps below.

    Args:
        images: (H, W) grey or (H, W, 3) BGR.
        pixels: (M, 2) in the first and (M, 2) in the second image.
        kept: (M,) which matches RANSAC keeps.
        title: names of algorithm and images.
    """
    figure = Figure(figsize=(9.0, 7.6), layout="constrained")
    above, below = figure.subplots(2, 1)
    figure.suptitle(title)
    _draw(above, images, pixels, kept, f"without RANSAC: {len(kept)} matches")
    _draw(below, images, (pixels[0][kept], pixels[1][kept]), kept[kept], f"with RANSAC: {kept.sum()} matches")
    return figure


def save_match_picture(path: Path, figure: Figure) -> Path:
    """Write the picture; make its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(figure, path)


def _draw(
    axes: Axes,
    images: tuple[Image, Image],
    pixels: tuple[NDArray[np.floating], NDArray[np.floating]],
    kept: NDArray[np.bool_],
    caption: str,
) -> None:
    first, second = (_rgb(image) for image in images)
    height, gap = max(first.shape[0], second.shape[0]), max(4, first.shape[1] // 60)
    canvas = np.full((height, first.shape[1] + gap + second.shape[1], 3), 255, np.uint8)
    canvas[: first.shape[0], : first.shape[1]] = first
    canvas[: second.shape[0], first.shape[1] + gap :] = second
    axes.imshow(canvas, interpolation="antialiased")
    lines = np.stack([pixels[0], pixels[1] + np.array([first.shape[1] + gap, 0])], axis=1)
    few = np.linspace(0, len(lines) - 1, min(len(lines), MOST_LINES)).astype(int)
    colours = np.where(kept[few], KEPT, REMOVED)
    axes.add_collection(LineCollection(list(lines[few]), colors=list(colours), linewidths=0.6, alpha=0.8))
    axes.set_title(caption if len(few) == len(lines) else f"{caption}, {len(few)} of them drawn", fontsize=10)
    axes.set_axis_off()


def _rgb(image: Image) -> NDArray[np.uint8]:
    """Return an image of any kind as (H, W, 3) RGB, 8 bits."""
    if image.dtype != np.uint8:
        image = np.asarray(image, float) * (255.0 / max(1.0, float(np.max(image))))
    colour = np.dstack([image] * 3) if image.ndim == 2 else image[:, :, ::-1]
    return np.asarray(colour, np.uint8)
