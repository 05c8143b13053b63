# SPDX-License-Identifier: Apache-2.0
"""Packets of made-up beliefs."""

from collections.abc import Callable

import numpy as np
import pytest

from uav_vslam.slam.packet import make_packet
from uav_vslam.types import LandmarkPacket


@pytest.fixture(scope="session")
def make_small_packet(make_joint) -> Callable[..., LandmarkPacket]:
    """Return a maker of valid packets that differ in their key and stamp only."""

    def make(sequence: int, *, vehicle: str = "uav2", session: int = 1, stamp_ns: int | None = None) -> LandmarkPacket:
        joint = make_joint(
            [[1.0, 2.0, 0.0]],
            np.eye(9),
            vehicle=vehicle,
            session=session,
            stamp_ns=sequence * 1_000_000_000 if stamp_ns is None else stamp_ns,
        )
        return make_packet(joint, sequence=sequence, max_landmarks=5)

    return make
