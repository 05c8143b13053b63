# SPDX-License-Identifier: Apache-2.0
"""IMU readings of a sensor that is turned against the body, and away from its origin.

With the body's angular rate w and the IMU at the lever arm l, all in the body's axes, the specific force there is

    f_imu = f_body + dw/dt x l + w x (w x l)

dw/dt is the difference of successive readings. Its noise telescopes when readings are integrated: a velocity error of
the gyroscope's noise times l stays, and does not grow. But single readings have all of it, at 200 Hz and 1 m easily
thirty times the accelerometer's own, so its noise, and whether it rests, are judged by what it measured itself.
"""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.types import NS_PER_S, ImuSample

Array = NDArray[np.float64]


class ImuMounting:
    """Moves the readings of one IMU, one after another, to the origin and axes of the body."""

    def __init__(self, T_body_imu: Pose) -> None:
        """Set up for the IMU's pose in the body."""
        self._R_body_imu, self._arm_body = T_body_imu.R, T_body_imu.t
        self._is_body = np.array_equal(T_body_imu.matrix, np.eye(4))
        self._previous: tuple[int, Array] | None = None  # stamp and rate in the body's axes

    def to_body(self, reading: ImuSample) -> ImuSample:
        """Return a reading as the body's origin would feel it; the first one's dw/dt counts as zero."""
        if self._is_body:
            return reading
        gyro, force = self._R_body_imu @ reading.gyro, self._R_body_imu @ reading.accel
        turning = np.cross(gyro, np.cross(gyro, self._arm_body))
        if self._previous is not None and reading.stamp_ns > self._previous[0]:
            stamp_ns, rate = self._previous
            turning += np.cross((gyro - rate) * (NS_PER_S / (reading.stamp_ns - stamp_ns)), self._arm_body)
        self._previous = (reading.stamp_ns, gyro)
        return ImuSample(reading.stamp_ns, gyro, force - turning, measured=force)
