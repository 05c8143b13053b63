# SPDX-License-Identifier: Apache-2.0
"""Runs whose errors are known, and pictures that can be read."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.studies.engine.own_only import Run, Track

FRAMES = 40


def line(offset=(0.0, 0.0, 0.0), *, frames: int = FRAMES, sigma_m: float = 1.0) -> Trajectory:
    """Return poses along x at 2 m a frame; the offset grows over the flight to what is given."""
    share = np.arange(frames)[:, None] / (FRAMES - 1)
    positions = np.arange(frames)[:, None] * [2.0, 0.0, 0.0] + share * np.asarray(offset)
    return Trajectory(
        np.arange(frames, dtype=np.int64) * 140_000_000,
        positions,
        np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)),
        np.tile(sigma_m**2 * np.eye(6), (frames, 1, 1)),
    )


@pytest.fixture
def make_run() -> Callable[..., Run]:
    """Make a run that ends `end` off, where the INS ends `ins` off, each in x, y, z [m]."""

    def make(
        name="eif", end=(1.0, 0.0, 0.0), ins=(10.0, 10.0, 10.0), *, condition="w1", seed=1, frames=FRAMES, **track
    ):
        return Run(name, condition, seed, "uav1", Track(line(end, frames=frames), **track), line(), line(ins))

    return make


@pytest.fixture
def drawn(tmp_path: Path) -> Callable[..., list[str]]:
    """Draw the content of a study.json, look at the pictures and return their names."""

    def draw_all(draw, tree) -> list[str]:
        paths = draw(tree, tmp_path)
        for path in paths:
            picture = cv2.imread(str(path))
            assert min(picture.shape[:2]) > 200
            assert picture.std() > 5
        return [path.name for path in paths]

    return draw_all
