# SPDX-License-Identifier: Apache-2.0
"""Where the unknowns of a flight are in the normal equations."""

from dataclasses import dataclass

import numpy as np

from uav_vslam.estimation.models import POSE
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.smoothing.sightings import Rows


@dataclass(frozen=True, slots=True)
class Layout:
    """Rows of the states, in blocks, and of the border.

    Attributes:
        states: number of states; each has its navigation error, then the camera's vibration.
        size: states of one block.
        vibration: rows of the vibration, 0 or 3.
        rig: rows of the rig's constant errors; the border begins with them.
        landmarks: revisited ones, 3 rows each, after the rig's.
    """

    states: int
    size: int
    vibration: int
    rig: int
    landmarks: int

    @property
    def stride(self) -> int:
        """Rows of one state."""
        return NAV_DIM + self.vibration

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-self.states // self.size)

    @property
    def border(self) -> int:
        """Rows of the border."""
        return self.rig + 3 * self.landmarks

    @property
    def seen(self) -> Rows:
        """Rows of one state that the cameras see: position, attitude, vibration."""
        return np.concatenate([POSE, np.arange(NAV_DIM, self.stride)])

    @property
    def seen_of_block(self) -> Rows:
        """The same rows of all states of a block."""
        return np.asarray((self.stride * np.arange(self.size)[:, None] + self.seen).ravel())

    def place(self, state: int) -> tuple[int, slice]:
        """Return block and rows of a state's navigation error."""
        block, row = divmod(state, self.size)
        return block, slice(row * self.stride, row * self.stride + NAV_DIM)

    def landmark(self, row: int) -> slice:
        """Return the rows of a revisited landmark in the border."""
        return slice(self.rig + 3 * row, self.rig + 3 * row + 3)
