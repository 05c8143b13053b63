# SPDX-License-Identifier: Apache-2.0
"""Ground truth of a data set: samples for the bag, and the start state that is taken from it."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.importing.tables import Table
from uav_vslam.datasets.messages import TruthSample
from uav_vslam.errors import BagError
from uav_vslam.geometry.pose import Pose
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState

Array = NDArray[np.float64]

GAP_NS = 100_000_000  # largest gap between rows across which the start state is interpolated
DIFFERENCE_NS = 50_000_000  # velocities are differences of positions this far apart


@dataclass(frozen=True, slots=True)
class InitialSigma:
    """Stated uncertainty of the start state, which is the ground truth."""

    position_m: float = 0.01
    velocity: float = 0.02  # [m/s]
    attitude_deg: float = 0.2
    gyro_bias: float = 1e-3  # [rad/s]
    accel_bias: float = 2e-2  # [m/s^2]

    def covariance(self) -> Array:
        """Return the (15, 15) covariance in the order of `NavEstimate`."""
        attitude = np.deg2rad(self.attitude_deg)
        sigma = [self.position_m, self.velocity, attitude, self.gyro_bias, self.accel_bias]
        return np.diag(np.repeat(sigma, 3) ** 2)


@dataclass(frozen=True, slots=True)
class Motion:
    """True motion of the body in a world whose z is up.

    Attributes:
        table: rows of position [m] (3), quaternion wxyz (4), velocity [m/s] (3), gyroscope bias [rad/s] (3) and
            accelerometer bias [m/s^2] (3).
        source: named in errors.
        gap_ns: largest gap between rows across which the start state is interpolated [ns].
    """

    table: Table
    source: Path
    gap_ns: int = field(default=GAP_NS, kw_only=True)

    def __post_init__(self) -> None:
        """Turn the signs of quaternions so that neighbours, between which rows are interpolated, are no antipodes."""
        values = self.table.values.copy()
        flips = np.where(np.sum(values[1:, 3:7] * values[:-1, 3:7], axis=1) < 0, -1.0, 1.0)
        values[1:, 3:7] *= np.cumprod(flips)[:, None]
        object.__setattr__(self, "table", Table(self.table.stamps_ns, values))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(N,) stamps [ns]."""
        return self.table.stamps_ns

    def covers(self, stamp_ns: int) -> bool:
        """Return whether a stamp is neither before the first nor after the last row."""
        return bool(self.stamps_ns[0] <= stamp_ns <= self.stamps_ns[-1])

    def samples(self, imu: Table | None) -> Iterator[TruthSample]:
        """Yield the motion at each row; the angular rate is that of the (N, 6) readings without the bias.

        Without readings it is unknown, NaN.
        """
        rows = self.table.values
        rates = imu.at(self.stamps_ns)[:, :3] - rows[:, 10:13] if imu else np.full((len(rows), 3), np.nan)
        for stamp, row, rate in zip(self.stamps_ns.tolist(), rows, rates, strict=True):
            yield TruthSample(stamp, Pose.from_quaternion_wxyz(row[3:7], row[:3]), row[7:10], rate)

    def start(self, stamp_ns: int, sigma: InitialSigma) -> NavEstimate:
        """Return the state at a stamp, interpolated between rows.

        Raises:
            BagError: the rows around it are too far apart.
        """
        after = min(int(np.searchsorted(self.stamps_ns, stamp_ns)), len(self.table) - 1)
        before = max(int(np.searchsorted(self.stamps_ns, stamp_ns, side="right")) - 1, 0)
        if self.stamps_ns[after] - self.stamps_ns[before] > self.gap_ns:
            raise BagError(
                f"{self.source}: ground truth has a gap at the first image ({stamp_ns} ns); cut the sequence later"
            )
        row = self.table.at(np.array([stamp_ns]))[0]
        state = NavState(stamp_ns, Pose.from_quaternion_wxyz(row[3:7], row[:3]), row[7:10], row[10:13], row[13:16])
        return NavEstimate(state, sigma.covariance())


def motion_of_poses(
    stamps_ns: NDArray[np.int64],
    positions_world: Array,
    quaternions_wxyz: Array,
    *,
    source: Path,
    velocities_world: Array | None = None,
    gap_ns: int = GAP_NS,
) -> Motion:
    """Return the motion of poses in stamp order, with biases of zero.

    Args:
        stamps_ns: (N,) [ns].
        positions_world: (N, 3) [m].
        quaternions_wxyz: (N, 4), of either sign.
        source: named in errors.
        velocities_world: (N, 3) [m/s]; None: differences of the positions.
        gap_ns: largest gap between rows across which the start state is interpolated [ns].
    """
    if velocities_world is None:
        velocities_world = _differences(stamps_ns, positions_world)
    biases = np.zeros((len(stamps_ns), 6))
    rows = np.column_stack([positions_world, quaternions_wxyz, velocities_world, biases])
    return Motion(Table(stamps_ns, rows), source, gap_ns=gap_ns)


def imu_samples(imu: Table) -> Iterator[ImuSample]:
    """Yield the readings of (N, 6) rows: angular rate [rad/s], specific force [m/s^2]."""
    for stamp, row in zip(imu.stamps_ns.tolist(), imu.values, strict=True):
        yield ImuSample(stamp, row[:3], row[3:])


def _differences(stamps_ns: NDArray[np.int64], positions: Array) -> Array:
    """Return (N, 3) velocities by parabolas through three positions, far enough apart to bear the noise of dense ones.

    Inside a track these are central differences; at its ends the parabola lies to one side.
    """
    seconds = (stamps_ns - stamps_ns[0]) / NS_PER_S
    last = len(stamps_ns) - 1
    if last < 2 or stamps_ns[-1] - stamps_ns[0] < 4 * DIFFERENCE_NS:
        return np.gradient(positions, seconds, axis=0) if last > 0 else np.zeros_like(positions)
    rows = np.arange(last + 1)
    later = np.maximum(np.searchsorted(stamps_ns, stamps_ns + DIFFERENCE_NS, side="right") - 1, rows + 1)
    earlier = np.minimum(np.searchsorted(stamps_ns, stamps_ns - DIFFERENCE_NS), rows - 1)
    nodes = np.column_stack([earlier, rows, later])
    begins, ends = seconds < DIFFERENCE_NS / NS_PER_S, seconds[-1] - seconds < DIFFERENCE_NS / NS_PER_S
    nodes[begins] = np.column_stack([rows, later, later[later.clip(0, last)]])[begins]
    nodes[ends] = np.column_stack([earlier[earlier], earlier, rows])[ends]
    nodes = nodes.clip(0, last)
    distinct = (np.diff(nodes) > 0).all(axis=1)  # not where a gap at an end leaves fewer than three
    velocities = np.gradient(positions, seconds, axis=0)
    velocities[distinct] = _slope_of_parabolas(seconds[distinct], seconds[nodes[distinct]], positions[nodes[distinct]])
    return np.asarray(velocities)


def _slope_of_parabolas(at: Array, times: Array, values: Array) -> Array:
    """Return (N, 3) slopes at (N,) times of the parabolas through (N, 3, 3) values at (N, 3) times."""
    a, b, c = times.T
    weights = [
        (2 * at - b - c) / ((a - b) * (a - c)),
        (2 * at - a - c) / ((b - a) * (b - c)),
        (2 * at - a - b) / ((c - a) * (c - b)),
    ]
    return np.asarray(np.einsum("kn,nkd->nd", np.array(weights), values))
