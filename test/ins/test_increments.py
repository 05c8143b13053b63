# SPDX-License-Identifier: Apache-2.0
"""Composed and extended increments against one preintegration over the whole interval."""

import dataclasses

import numpy as np
import pytest
from increment_error import difference
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.increments import bridged, compose, error_transfer
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.types import ImuIncrement, ImuSample

Array = NDArray[np.float64]

IMU = ImuConfig()
BIAS = {"gyro_bias": np.array([0.01, -0.02, 0.015]), "accel_bias": np.array([0.1, 0.2, -0.1])}
START_S, FRAME_S = 3.0, 0.14  # one image interval in the middle of a turn
STEP = 1e-5  # of an error, for forward differences


def integrate(samples: list[ImuSample]) -> ImuIncrement:
    return preintegrate(samples, samples[0].stamp_ns, samples[-1].stamp_ns, **BIAS, imu=IMU)


def two_halves(readings) -> tuple[ImuIncrement, ImuIncrement, ImuIncrement]:
    """Two adjacent increments and the one over both, with a reading on the boundary."""
    samples = readings(START_S, FRAME_S, 28)
    return integrate(samples[:15]), integrate(samples[14:]), integrate(samples)


def test_composed_increments_equal_the_one_over_both(readings) -> None:
    first, second, whole = two_halves(readings)
    composed = compose(first, second)
    assert (composed.start_ns, composed.stamp_ns) == (whole.start_ns, whole.stamp_ns)
    np.testing.assert_allclose(difference(composed, whole), np.zeros(9), rtol=0, atol=1e-12)
    np.testing.assert_allclose(composed.bias_jacobian, whole.bias_jacobian, rtol=0, atol=1e-12)
    np.testing.assert_allclose(composed.covariance, whole.covariance, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(composed.rate_start, whole.rate_start, rtol=0, atol=1e-12)
    np.testing.assert_allclose(composed.rate_slope_start, whole.rate_slope_start, rtol=0, atol=1e-9)
    np.testing.assert_allclose(composed.rate_end, whole.rate_end, rtol=0, atol=1e-12)
    np.testing.assert_allclose(composed.rate_slope_end, whole.rate_slope_end, rtol=0, atol=1e-9)


def test_error_transfer_is_the_derivative_of_the_composition(readings) -> None:
    first, second, _ = two_halves(readings)
    whole = compose(first, second)
    for derivative, parts in zip(error_transfer(first, second), ((first, None), (None, second)), strict=True):
        for axis in range(9):
            error = np.zeros(9)
            error[axis] = STEP
            moved = [disturbed(part, error) if part is not None else None for part in parts]
            found = difference(compose(moved[0] or first, moved[1] or second), whole) / STEP
            np.testing.assert_allclose(found, derivative[:, axis], rtol=0, atol=10 * STEP)


def disturbed(increment: ImuIncrement, error: Array) -> ImuIncrement:
    return dataclasses.replace(
        increment,
        delta_R=increment.delta_R @ so3_exp(error[:3]),
        delta_v=increment.delta_v + error[3:6],
        delta_p=increment.delta_p + error[6:],
    )


def test_increments_that_are_not_adjacent_are_rejected(readings) -> None:
    first, second, _ = two_halves(readings)
    with pytest.raises(ValueError, match="does not follow"):
        compose(second, first)
    with pytest.raises(ValueError, match="different biases"):
        compose(first, dataclasses.replace(second, gyro_bias=np.zeros(3)))


def test_a_bridged_increment_starts_earlier_with_a_large_covariance(readings) -> None:
    known = integrate(readings(START_S, FRAME_S, 28))
    whole = bridged(known, known.start_ns - 200_000_000, IMU)
    assert (whole.start_ns, whole.stamp_ns) == (known.start_ns - 200_000_000, known.stamp_ns)
    assert whole.samples == known.samples
    hover = np.array([0.0, 0.0, IMU.gravity])
    np.testing.assert_allclose(whole.delta_v, 0.2 * hover + known.delta_v, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(whole.rate_end, known.rate_end)
    sigma = np.sqrt(np.diag(whole.covariance))
    assert (sigma[3:6] >= 0.5).all()  # half a metre a second after 0.2 s: the vehicle may have started a turn
    assert np.linalg.eigvalsh(whole.covariance)[0] > 0
