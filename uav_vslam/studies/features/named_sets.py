# SPDX-License-Identifier: Apache-2.0
"""The image sets that the command line names: data sets, folders, pairs of files."""

import os
from pathlib import Path

from uav_vslam.datasets.image_sets import LAYOUTS, Layout, files_of, read_image, shift_between
from uav_vslam.errors import ConfigError
from uav_vslam.studies.features.sets import ImageSet, View, downscaled, static_truth


def available_sets() -> list[str]:
    """Return the names of the data sets on this machine."""
    root = os.environ.get("UAV_VSLAM_DATA")
    return [name for name in LAYOUTS if root and (Path(root) / name).is_dir()]


def read_set(text: str, width: int) -> ImageSet:
    """Return the set that an argument names."""
    if "," in text:
        pair = [Path(part) for part in text.split(",")]
        name = " ".join(dict.fromkeys(path.parent.name or "." for path in pair))
        return _loaded(name, Layout({"images": ""}, (1,)), {"images": dict(enumerate(pair))}, width)
    if text in LAYOUTS:
        folder = Path(os.environ.get("UAV_VSLAM_DATA", ".")) / text
        if not folder.is_dir():
            raise ConfigError(f"data set {text} is not at {folder}; let UAV_VSLAM_DATA name the folder that holds it")
        return _loaded(text, LAYOUTS[text], files_of(LAYOUTS[text], folder), width)
    if not Path(text).is_dir():
        raise ConfigError(f"{text} is no folder, no pair A,B of files and none of {', '.join(LAYOUTS)}")
    layout = Layout({"images": "*"})
    return _loaded(Path(text).resolve().name, layout, files_of(layout, Path(text)), width)


def _loaded(name: str, layout: Layout, files: dict[str, dict[int, Path]], width: int) -> ImageSet:
    """Read a set's images and shrink the wide ones."""
    bands = {
        band: {k: View(name, band, k, path.stem, downscaled(read_image(path), width)) for k, path in paths.items()}
        for band, paths in files.items()
    }
    truth = None
    if layout.still:
        last = {band: views[max(views)].image for band, views in bands.items()}
        truth = static_truth(
            {(b, k): shift_between(view.image, last[b]) for b, vs in bands.items() for k, view in vs.items()}
        )
    return ImageSet(name, bands, layout.spacings, layout.usual, layout.cross, truth, layout.still)
