# SPDX-License-Identifier: Apache-2.0
"""How a vehicle turns about the stamp of an image: the exposure, some milliseconds off, shows another attitude.

The rate alone would do for 3 ms. In gusts it changes by some rad/s^2: at 10 ms that is a tenth of a pixel, twice the
noise of tracked points, and nearly all miss their gates.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.types import ImuIncrement, NavState

Array = NDArray[np.float64]

TAILS = 2.0  # gusts are not normal: few are far larger than their root mean square


@dataclass(frozen=True, slots=True)
class Turning:
    """Angular rates that change steadily.

    Attributes:
        rate_map: (..., 3) at the stamp, map frame [rad/s].
        slope_map: (..., 3) its change over time [rad/s^2].
    """

    rate_map: Array
    slope_map: Array

    @classmethod
    def none(cls) -> Self:
        """Return that of a vehicle that does not turn."""
        return cls(np.zeros(3), np.zeros(3))

    @classmethod
    def at_start(cls, increment: ImuIncrement, nav: NavState) -> Self:
        """Return that at the start of an increment, where the vehicle has a state."""
        R = nav.T_map_body.R
        return cls(R @ (increment.rate_start - nav.gyro_bias), R @ increment.rate_slope_start)

    @classmethod
    def at_end(cls, increment: ImuIncrement, nav: NavState) -> Self:
        """Return that at the end of an increment, where the vehicle has a state."""
        R = nav.T_map_body.R
        return cls(R @ (increment.rate_end - nav.gyro_bias), R @ increment.rate_slope_end)

    def rotation(self, later_s: float) -> Array:
        """Return (..., 3) the rotation vector from the stamp to a time after it, map frame [rad]."""
        return (self.rate_map + 0.5 * later_s * self.slope_map) * later_s

    def rate(self, later_s: float) -> Array:
        """Return (..., 3) the rate some time after the stamp, map frame [rad/s]."""
        return self.rate_map + later_s * self.slope_map


@dataclass(frozen=True, slots=True)
class Gusts:
    """How much the slope of the rates differs after a stamp, which the readings before it don't show.

    Attributes:
        squares: sum of the squared differences, one axis [rad^2/s^4].
        count: how many.
    """

    squares: float = 4.0
    count: int = 1

    def added(self, before: Turning, after: Turning) -> Self:
        """Add what the readings on both sides of a stamp show."""
        change = after.slope_map - before.slope_map
        return type(self)(self.squares + float(change @ change) / len(change), self.count + 1)

    def rotation_variance(self, later_s: float) -> float:
        """Return the variance of `Turning.rotation` by the readings before the stamp, one axis [rad^2]."""
        return TAILS**2 * self.squares / self.count * (0.5 * max(later_s, 0.0) ** 2) ** 2
