# SPDX-License-Identifier: Apache-2.0
"""Packets of made-up beliefs, and two maps of the same landmarks."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from uav_vslam.cooperation.point_pairs import PointPairs
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import rotation_from_rpy, so3_exp
from uav_vslam.slam.packet import PacketPolicy, make_packet
from uav_vslam.types import LandmarkPacket
from uav_vslam.vision.compact_descriptors import RAW


@pytest.fixture(scope="session")
def make_small_packet(make_joint) -> Callable[..., LandmarkPacket]:
    """Return a factory of valid packets that differ in their key and stamp only."""

    def make(sequence: int, *, vehicle: str = "uav2", session: int = 1, stamp_ns: int | None = None) -> LandmarkPacket:
        joint = make_joint(
            [[1.0, 2.0, 0.0]],
            np.eye(9),
            vehicle=vehicle,
            session=session,
            stamp_ns=sequence * 1_000_000_000 if stamp_ns is None else stamp_ns,
        )
        return make_packet(joint, sequence=sequence, policy=PacketPolicy(max_landmarks=5))

    return make


NUMBERS = itertools.count(1)


@dataclass(frozen=True)
class SentMap:
    """What matching and alignment read of a packet, not rounded by any coding."""

    positions: np.ndarray
    covariance: np.ndarray
    descriptors: np.ndarray
    session: int = 1
    descriptor_basis: int = RAW
    identifiers: np.ndarray | None = None
    order: tuple[int, int] = field(default_factory=lambda: (next(NUMBERS), 1))

    @property
    def ids(self) -> np.ndarray:
        """Identifiers: those given, or the rows."""
        return np.arange(len(self.positions), dtype=np.uint32) if self.identifiers is None else self.identifiers

    def __len__(self) -> int:
        return len(self.positions)


@pytest.fixture(scope="session")
def sent_map() -> type[SentMap]:
    """Return a stand-in for a packet."""
    return SentMap


def _drifted(
    points: np.ndarray, rng, sigma_m: float, drift: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Draw a map of (K, 3) points: a common shift, yaw and tilt, and independent errors; and its covariance.

    `drift` holds the sigmas of the shift [m], the yaw and the tilt [rad].
    """
    shift, yaw, tilt = drift
    shared = np.zeros((len(points), 3, 6))
    shared[:, :, :3] = np.eye(3)
    shared[:, :, 3:] = np.stack([np.cross(axis, points) for axis in np.eye(3)], axis=2)
    shared = shared.reshape(-1, 6) * [shift, shift, shift, tilt, tilt, yaw]
    draw = rng.normal(size=6)
    turn = so3_exp(draw[3:] * [tilt, tilt, yaw])
    moved = points @ turn.T + shift * draw[:3] + sigma_m * rng.normal(size=points.shape)
    return moved, shared @ shared.T + sigma_m**2 * np.eye(points.size)


@pytest.fixture(scope="session")
def two_maps() -> Callable[..., tuple[PointPairs, Pose]]:
    """Return a factory of pairs between two maps, and of the true T_own_peer between their frames.

    The last `wrong` pairs join landmarks that are not the same.
    """

    def make(
        seed: int = 0,
        *,
        right: int = 14,
        wrong: int = 0,
        sigma_m: float = 0.3,
        drift: tuple[float, float, float] = (1.0, 0.01, 0.002),
        yaw: float = 2.0,
        t: tuple[float, float, float] = (30.0, -20.0, 5.0),
        points: np.ndarray | None = None,
    ) -> tuple[PointPairs, Pose]:
        rng = np.random.default_rng(seed)
        if points is None:
            points = np.column_stack([rng.uniform(-50, 50, (right + wrong, 2)), rng.normal(0, 2, right + wrong)])
        T = Pose(rotation_from_rpy(0.0, 0.0, yaw), np.asarray(t))
        seen = points.copy()
        seen[right:] = np.column_stack([rng.uniform(-50, 50, (wrong, 2)), rng.normal(0, 2, wrong)])
        own, P = _drifted(points, rng, sigma_m, drift)
        peer, R = _drifted(T.inverse().apply(seen), rng, sigma_m, drift)
        return PointPairs(own, peer, P, R, floor_sigma_m=0.0), T

    return make
