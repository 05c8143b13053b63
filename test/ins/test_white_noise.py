# SPDX-License-Identifier: Apache-2.0
"""An IMU that is noisier than configured is weighted as its readings show; a right configuration is left as it is."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import IMU_GRADES, ImuConfig, VehicleConfig
from uav_vslam.ins.white_noise import ONSET, SEGMENT, SEGMENTS, WhiteNoise
from uav_vslam.pipeline import VehiclePipeline
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import NS_PER_S, ImuSample

RATE_HZ = 200
TRUE = ImuConfig(gyro_noise=2e-4, accel_noise=3e-3)
QUIET = dataclasses.replace(TRUE, gyro_noise=5e-5, accel_noise=7.5e-4)
ALL = SEGMENT * SEGMENTS
SHARE = 0.25  # 3 sigma of a density of the lower octave: 8 spectra of 9 lines, every other one independent


def readings(count: int, *, imu: ImuConfig = TRUE, tone: float = 0.0, seed: int = 1) -> list[ImuSample]:
    rng, t = np.random.default_rng(seed), np.arange(count)[:, None] / RATE_HZ
    motion = np.sin(2 * np.pi * np.array([0.5, 1.1, 2.3]) * t)
    sigma = np.sqrt(RATE_HZ)
    gyro = 0.3 * motion + rng.normal(0.0, imu.gyro_noise * sigma, (count, 3))
    accel = 2.0 * motion + [0.0, 0.0, 9.8] + rng.normal(0.0, imu.accel_noise * sigma, (count, 3))
    accel += tone * np.sin(2 * np.pi * 73.0 * t)
    return [ImuSample(k * NS_PER_S // RATE_HZ, gyro[k], accel[k]) for k in range(count)]


def measured(samples: list[ImuSample], configured: ImuConfig) -> ImuConfig:
    noise = WhiteNoise(configured)
    for sample in samples:
        noise.add(sample, 1.0 / RATE_HZ)
    return noise.imu


def test_noise_beyond_the_configured_one_is_measured() -> None:
    found = measured(readings(ALL), QUIET)
    assert found.gyro_noise == pytest.approx(TRUE.gyro_noise, rel=SHARE)
    assert found.accel_noise == pytest.approx(TRUE.accel_noise, rel=SHARE)
    assert dataclasses.replace(found, gyro_noise=0.1, accel_noise=0.1) == dataclasses.replace(
        QUIET, gyro_noise=0.1, accel_noise=0.1
    )


@pytest.mark.parametrize("seed", range(1, 21))
def test_a_right_configuration_holds_from_the_first_spectrum_on(seed: int) -> None:
    noise = WhiteNoise(TRUE)
    for sample in readings(20 * RATE_HZ, seed=seed):
        noise.add(sample, 1.0 / RATE_HZ)
        assert noise.imu is TRUE


def test_one_sensor_may_be_noisier_alone() -> None:
    found = measured(readings(ALL), dataclasses.replace(TRUE, accel_noise=7.5e-4))
    assert found.gyro_noise == TRUE.gyro_noise
    assert found.accel_noise > 2.0 * 7.5e-4


def test_what_is_beyond_all_configurations_counts_as_the_largest() -> None:
    broken = [dataclasses.replace(sample, gyro=1e4 * sample.gyro) for sample in readings(ALL)]
    assert measured(broken, TRUE).gyro_noise == 1.0


def test_vibration_at_one_frequency_is_no_white_noise() -> None:
    assert measured(readings(ALL, tone=1.0), TRUE) is TRUE


def test_noise_that_is_gone_is_forgotten() -> None:
    loud, quiet = readings(ALL), readings(2 * ALL, imu=QUIET)[ALL:]
    assert measured(loud + quiet[: ALL // 2], QUIET) != QUIET
    assert measured(loud + quiet, QUIET) is QUIET


@pytest.mark.parametrize("seed", range(1, 21))
def test_noise_that_begins_is_seen_by_its_first_readings(seed: int) -> None:
    """As when motors start: the mean with what was measured at rest would claim a third of it, for half a second."""
    begun = readings(2 * ALL, imu=QUIET, seed=seed)[:ALL] + readings(2 * ALL, seed=seed)[ALL:]
    assert measured(begun[: ALL + 2 * ONSET], QUIET).accel_noise == pytest.approx(TRUE.accel_noise, rel=4 * SHARE)
    assert measured(begun[: 2 * ALL], QUIET).accel_noise == pytest.approx(TRUE.accel_noise, rel=SHARE)


def test_a_spectrum_never_spans_a_gap() -> None:
    samples = readings(2 * SEGMENT)
    assert measured(samples[: SEGMENT - 1] + samples[SEGMENT : 2 * SEGMENT - 1], QUIET) is QUIET
    assert measured(samples[: SEGMENT - 1] + samples[SEGMENT : 2 * SEGMENT], QUIET) != QUIET


def test_it_can_be_switched_off() -> None:
    fixed = dataclasses.replace(QUIET, noise_from_readings=False)
    assert measured(readings(ALL), fixed) is fixed


@pytest.mark.slow
def test_a_consumer_unit_configured_as_a_tactical_one_still_flies() -> None:
    """Without the measurement gates refuse most landmarks, and the rig's calibration is blamed."""
    scenario = dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=80, imu="consumer", seed=1)
    (simulated,) = simulate_fleet(scenario)
    source = SimulatedSource(simulated, scatter_landmarks([simulated]))

    def fly(imu: ImuConfig) -> tuple[float, float, list[str]]:
        """Return the error and NEES at the frames, and the warnings."""
        pipeline = VehiclePipeline(source.initial_state, rig=source.rig, config=VehicleConfig(imu=imu), vehicle="uav1")
        navs = [output.report.nav for output in pipeline.run(source.iter_events())]
        errors = np.array(
            [nav.state.T_map_body.t - simulated.true_state(nav.state.stamp_ns).T_map_body.t for nav in navs]
        )
        nees = [e @ np.linalg.solve(nav.covariance[:3, :3], e) / 3 for e, nav in zip(errors, navs, strict=True)]
        return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))), float(np.mean(nees)), pipeline.track.warnings

    tactical = ImuConfig()
    fixed_m, _, _ = fly(dataclasses.replace(tactical, noise_from_readings=False))
    right_m, _, _ = fly(IMU_GRADES["consumer"])
    found_m, found_nees, warnings = fly(tactical)
    assert fixed_m > 2.0 * right_m
    assert found_m < 1.5 * right_m
    assert found_nees < 1.5
    (warning,) = warnings
    assert "times imu.gyro_noise" in warning
    assert "times imu.accel_noise" in warning
    assert "check their units (rad/s, m/s^2)" in warning
