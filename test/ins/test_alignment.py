# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.config import IMU_GRADES
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.rotation import rotation_from_rpy, rpy_from_rotation, so3_exp, so3_log
from uav_vslam.ins.alignment import biased_rest, levelled, static_alignment
from uav_vslam.types import ImuSample

IMU = IMU_GRADES["consumer"]


def resting(roll, pitch, *, count=200, gyro_bias=(0.01, -0.02, 0.03), noise=0.01):
    rng = np.random.default_rng(1)
    up_body = rotation_from_rpy(roll, pitch, 0.7).T @ [0.0, 0.0, IMU.gravity]
    return [
        ImuSample(
            5_000_000 * k, np.asarray(gyro_bias) + rng.normal(0, noise / 10, 3), up_body + rng.normal(0, noise, 3)
        )
        for k in range(count)
    ]


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.2), (-2.5, 0.4), (0.1, 1.4)])
def test_tilt_follows_from_gravity_and_the_bias_from_the_gyroscope(roll, pitch):
    nav = static_alignment(resting(roll, pitch), 10**9, IMU)
    expected = rotation_from_rpy(roll, pitch, 0.0)
    np.testing.assert_allclose(nav.state.T_map_body.R, expected, atol=1e-3)  # 0.01 m/s^2 over sqrt(200) readings
    np.testing.assert_allclose(nav.state.gyro_bias, [0.01, -0.02, 0.03], atol=5e-4)
    assert nav.state.stamp_ns == 10**9
    assert np.linalg.eigvalsh(nav.covariance)[0] > 0


def test_a_bias_along_gravity_far_beyond_its_sigma_widens_the_start():
    """It is one draw of a bias of which the other two tilt."""
    usual, biased = (static_alignment(at_rest_with(bias), 10**9, IMU) for bias in (0.9, 5.0))
    assert biased_rest(usual, IMU) == ""
    assert usual.covariance[-1, -1] == pytest.approx(IMU.accel_bias_sigma**2)
    off = 5.0 * IMU.accel_bias_sigma
    assert biased.covariance[-1, -1] == pytest.approx(off**2, rel=0.01)
    assert biased.covariance[6, 6] == pytest.approx((off / IMU.gravity) ** 2, rel=0.01)
    assert "5.0 times imu.accel_bias_sigma" in biased_rest(biased, IMU)


def at_rest_with(sigmas):
    bias = np.array([0.0, 0.0, sigmas * IMU.accel_bias_sigma])
    return [ImuSample(s.stamp_ns, s.gyro, s.accel + bias) for s in resting(0.0, 0.0)]


def test_an_accelerometer_bias_of_one_sigma_tilts_by_about_one_sigma():
    samples = resting(0.0, 0.0)
    biased = [ImuSample(s.stamp_ns, s.gyro, s.accel + np.array([0.0, IMU.accel_bias_sigma, 0.0])) for s in samples]
    nav = static_alignment(biased, 10**9, IMU)
    roll = np.arctan2(nav.state.T_map_body.R[2, 1], nav.state.T_map_body.R[2, 2])
    assert 0.9 < abs(roll) / np.sqrt(nav.covariance[6, 6]) < 1.1


def test_a_moving_vehicle_is_rejected():
    with pytest.raises(UavVslamError, match="moves"):
        static_alignment(resting(0.0, 0.0, noise=2.0), 10**9, IMU)


def test_a_steady_turn_is_no_bias():
    """As steady as rest by their spread, 0.5 rad/s in flight were taken for the gyroscope's bias."""
    with pytest.raises(UavVslamError, match=r"turns at 0.50 rad/s, .* set start.method: in_flight"):
        static_alignment(resting(0.0, 0.0, gyro_bias=(0.0, 0.0, 0.5)), 10**9, IMU)
    assert static_alignment(resting(0.0, 0.0, gyro_bias=(0.0, 0.0, 0.3)), 10**9, IMU).state.gyro_bias[2] > 0.29


def test_readings_in_g_are_rejected():
    in_g = [ImuSample(s.stamp_ns, s.gyro, s.accel / IMU.gravity) for s in resting(0.0, 0.0)]
    with pytest.raises(UavVslamError, match=r"measures 1 m/s\^2, where gravity is 9.81: check its unit"):
        static_alignment(in_g, 10**9, IMU)


def test_a_gyroscope_alone_is_named_in_flight_as_well():
    """It was said to move, and with start.method: in_flight that its accelerometer is missing."""
    turning = [ImuSample(s.stamp_ns, 100.0 * s.gyro, np.zeros(3)) for s in resting(0.0, 0.0)]
    with pytest.raises(UavVslamError, match=r"measures 0 m/s\^2.*have a live driver unite it"):
        static_alignment(turning, 10**9, IMU)


def test_too_few_readings_are_rejected():
    with pytest.raises(UavVslamError, match="got 3"):
        static_alignment(resting(0.0, 0.0, count=3), 10**9, IMU)


def level(up_body, v_body=(0.0, 0.0, 0.0), *, sigma_tilt=0.02):
    return levelled(
        7,
        up_body=np.asarray(up_body),
        v_body=np.asarray(v_body),
        gyro_bias=np.zeros(3),
        sigma_velocity=5.0,
        sigma_tilt=sigma_tilt,
        sigma_gyro_bias=1e-3,
        sigma_accel_bias=0.1,
    )


def test_a_levelled_state_has_yaw_zero_and_its_velocity_in_the_map_frame():
    R = rotation_from_rpy(0.2, -0.3, 0.0)
    nav = level(R.T @ [0.0, 0.0, 2.0], R.T @ [3.0, 4.0, 5.0])
    np.testing.assert_allclose(nav.state.T_map_body.R, R, atol=1e-12)
    np.testing.assert_allclose(nav.state.v_map, [3.0, 4.0, 5.0], atol=1e-12)
    np.testing.assert_array_equal(nav.state.T_map_body.t, np.zeros(3))


@pytest.mark.parametrize("pitch", [0.0, 0.4, -1.2, -np.pi / 2])
def test_an_error_of_gravity_is_consistent_with_the_covariance_at_any_pitch(pitch):
    """The heading is right by definition, so there is an error of the tilt alone; here one sigma about each axis."""
    sigma = 0.02
    true = rotation_from_rpy(0.1, pitch, 0.7)
    nav = level(true.T @ so3_exp([sigma, sigma, 0.0])[2], sigma_tilt=sigma)
    _, _, heading = rpy_from_rotation(nav.state.T_map_body.R @ true.T)
    xi = so3_log(rotation_from_rpy(0.0, 0.0, heading) @ true @ nav.state.T_map_body.R.T)
    nees = xi @ np.linalg.solve(nav.covariance[6:9, 6:9], xi)
    assert 1.9 < nees < 2.1


@pytest.mark.parametrize("up_body", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)])
def test_every_attitude_can_be_levelled(up_body):
    nav = level(up_body)
    np.testing.assert_allclose(nav.state.T_map_body.R @ up_body, [0.0, 0.0, 1.0], atol=1e-12)
    assert np.linalg.eigvalsh(nav.covariance)[0] > 0
