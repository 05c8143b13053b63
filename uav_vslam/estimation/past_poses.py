# SPDX-License-Identifier: Apache-2.0
"""Past poses of the vehicle in the state.

Errors of their positions belong to the right-invariant chart, as those of landmarks do (`models.chart_transport`), so
position and yaw stay unobservable.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.types import NavState

Array = NDArray[np.float64]

COPY_VARIANCE: Array = np.repeat([1e-4, 1e-6], 3) ** 2  # [m^2], [rad^2]: an exact copy would be singular


@dataclass(frozen=True, slots=True)
class PastPoses:
    """The estimates of the vehicle at V earlier frames, oldest first.

    Attributes:
        stamps_ns: (V,).
        R, t: (V, 3, 3), (V, 3) of T_map_body, kept up to date by later measurements [m].
        v_map: (V, 3) velocity at those frames [m/s].
        rate_map, rate_slope_map: (V, 3) angular rate there, and its change [rad/s], [rad/s^2].
    """

    stamps_ns: NDArray[np.int64]
    R: Array
    t: Array
    v_map: Array
    rate_map: Array
    rate_slope_map: Array

    @classmethod
    def none(cls) -> Self:
        """Return no poses."""
        vectors = np.zeros((0, 3))
        return cls(np.zeros(0, np.int64), np.zeros((0, 3, 3)), *[vectors] * 4)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def pose(self, number: int) -> Pose:
        """Return T_map_body of one of them."""
        return Pose(self.R[number], self.t[number])

    def followed_by(self, nav: NavState, turning: Turning) -> Self:
        """Return these and a newer one."""
        T = nav.T_map_body
        newest = (np.array(nav.stamp_ns, np.int64), T.R, T.t, nav.v_map, turning.rate_map, turning.slope_map)
        return type(self)(*(np.concatenate([old, new[None]]) for old, new in zip(self._parts, newest, strict=True)))

    def with_newest(self, stamp_ns: int, **parts: Array) -> Self:
        """Return them with other parts of the newest one, if it is of that time."""
        if len(self) == 0 or self.stamps_ns[-1] != stamp_ns:
            return self
        changed = {name: np.concatenate([getattr(self, name)[:-1], part[None]]) for name, part in parts.items()}
        return dataclasses.replace(self, **changed)

    def without(self, numbers: NDArray[np.integer]) -> Self:
        """Return all but some."""
        return type(self)(*(np.delete(part, numbers, axis=0) for part in self._parts))

    def moved(self, xi: Array, positions: Array) -> Self:
        """Return them turned by (V, 3) map-frame rotation vectors [rad], at (V, 3) other positions [m]."""
        return dataclasses.replace(self, R=so3_exp(xi) @ self.R, t=positions)

    def at_exposure(self, time_offset_s: float) -> Self:
        """Return them at the exposures, that long after the stamps of the images."""
        if time_offset_s == 0.0:
            return self
        turning = Turning(self.rate_map, self.rate_slope_map)
        then = self.moved(turning.rotation(time_offset_s), self.t + self.v_map * time_offset_s)
        return dataclasses.replace(then, rate_map=turning.rate(time_offset_s))

    @property
    def _parts(self) -> tuple[NDArray[Any], ...]:
        return self.stamps_ns, self.R, self.t, self.v_map, self.rate_map, self.rate_slope_map
