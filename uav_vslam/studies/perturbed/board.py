# SPDX-License-Identifier: Apache-2.0
"""A rig as a calibration with a board finds it: `calibration.solve` from simulated corners with noise.

Its errors are correlated: principal points are off by far more than `calibration.PRINCIPAL_POINT_PX`, and the attitude
between the cameras by what makes up for it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.calibration.boards import Corners
from uav_vslam.calibration.bundle import BoardPair
from uav_vslam.calibration.solve import Lens, solve
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig

Array = NDArray[np.float64]

STREAM = 0x0B0A  # of the random numbers
PAIRS = 40
COLUMNS, ROWS, SQUARE_M = 9, 6, 0.25  # inner corners; a board for a baseline of 0.8 m
DEPTHS_M = (3.5, 7.0)
CORNER_PX = 0.15  # white noise of a corner's coordinate
BORDER_PX = 5.0
LENS = Lens("plumb_bob", ("k3",))


@dataclass(frozen=True, slots=True)
class BoardCalibration:
    """The calibration of one seed; the cameras' place in the body and their clock are exact."""

    seed: int
    time_offset_s: float = 0.0

    def applied(self, rig: StereoRig) -> StereoRig:
        """Return the rig as it is calibrated, with the lens coefficients that are estimated too."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, STREAM]))
        pairs = [_pair(rig, f"{k:02}", rng) for k in range(PAIRS)]
        found = solve(pairs, rig.left.size, LENS).rig
        return StereoRig(found.left, found.right, rig.T_body_left, rig.T_body_left @ found.T_right_left.inverse())


def _pair(rig: StereoRig, name: str, rng: np.random.Generator) -> BoardPair:
    """Return the corners of a board, tilted by up to 35 degrees about two axes, that both cameras see as a whole."""
    x, y = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    board = SQUARE_M * np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float64)
    limit = np.array(rig.left.size * 2) - BORDER_PX
    while True:
        R = so3_exp([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.4, 0.4)])
        ray = np.array([*rng.uniform([-0.5, -0.4], [0.5, 0.4]), 1.0])
        T_left_board = Pose(R, ray * rng.uniform(*DEPTHS_M) - R @ board.mean(axis=0))
        pixels = rig.project(T_left_board.apply(board))
        if np.all((pixels > BORDER_PX) & (pixels < limit)):
            break
    seen: Array = pixels + rng.normal(0.0, CORNER_PX, pixels.shape)
    return BoardPair(name, Corners(board, seen[:, :2]), Corners(board, seen[:, 2:]))
