# SPDX-License-Identifier: Apache-2.0
"""IMU readings of a true motion: turn-on bias, bias random walk and white noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.simulation.trajectory import Trajectory
from uav_vslam.types import NS_PER_S, ImuSample

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ImuReadings:
    """The IMU readings of one flight.

    Attributes:
        stamps_ns: (N,) int64 [ns].
        gyro: (N, 3) angular rates, body frame [rad/s].
        accel: (N, 3) specific forces, body frame [m/s^2].
        gyro_bias, accel_bias: (N, 3) the true biases contained in the readings.
    """

    stamps_ns: NDArray[np.int64]
    gyro: Array
    accel: Array
    gyro_bias: Array
    accel_bias: Array

    def samples(self) -> list[ImuSample]:
        """Return the readings as records."""
        return [ImuSample(int(s), w, f) for s, w, f in zip(self.stamps_ns, self.gyro, self.accel, strict=True)]


def ideal_imu(trajectory: Trajectory, stamps_ns: NDArray[np.int64], *, gravity: float) -> ImuReadings:
    """Return readings without any error at (N,) stamps."""
    t = trajectory.time_s(stamps_ns)
    zero = np.zeros((len(stamps_ns), 3))
    force = trajectory.specific_force_body(t, gravity=gravity)
    return ImuReadings(stamps_ns, trajectory.angular_rate_body(t), force, zero, zero)


def simulate_imu(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], config: ImuConfig, *, rng: np.random.Generator
) -> ImuReadings:
    """Return noisy readings: true + bias(t) + white noise of standard deviation density * sqrt(rate).

    Args:
        trajectory: the true motion.
        stamps_ns: (N,) evenly spaced stamps [ns].
        config: noise densities and the spread of the turn-on bias.
        rng: draws every error.
    """
    ideal = ideal_imu(trajectory, stamps_ns, gravity=config.gravity)
    dt_s = float(np.median(np.diff(stamps_ns))) / NS_PER_S
    shape = ideal.gyro.shape
    gyro_bias = _bias(config.gyro_bias_sigma, config.gyro_bias_walk, shape, dt_s, rng)
    accel_bias = _bias(config.accel_bias_sigma, config.accel_bias_walk, shape, dt_s, rng)
    gyro = ideal.gyro + gyro_bias + rng.normal(0.0, config.gyro_noise / np.sqrt(dt_s), shape)
    accel = ideal.accel + accel_bias + rng.normal(0.0, config.accel_noise / np.sqrt(dt_s), shape)
    return ImuReadings(stamps_ns, gyro, accel, gyro_bias, accel_bias)


def _bias(sigma: float, walk: float, shape: tuple[int, ...], dt_s: float, rng: np.random.Generator) -> Array:
    steps = rng.normal(0.0, walk * np.sqrt(dt_s), shape)
    return np.asarray(rng.normal(0.0, sigma, shape[1]) + np.cumsum(steps, axis=0))
