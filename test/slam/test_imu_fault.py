# SPDX-License-Identifier: Apache-2.0
"""Readings that contradict both gravity and the images cost accuracy for a while, but not the flight."""

import dataclasses
import functools
import itertools
from collections.abc import Callable

import numpy as np
import pytest
from flown_copy import copy_of

from uav_vslam.config import ImuConfig, VehicleConfig
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.imu_fault import FAULTY_AFTER, HEALTHY_AFTER, ImuFaultDetector
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import ImuIncrement, ImuSample, StereoFeatures

FRAMES, FIRST, SIGMA_PX = 60, 20, 0.05
SEEDS = range(310, 313)
SLOWEST = 8  # frames of readings that fit at first


def scaled(increment: ImuIncrement, factor: float) -> ImuIncrement:
    """Return the increment of an accelerometer whose readings are that many times the true ones."""
    return dataclasses.replace(increment, delta_v=factor * increment.delta_v, delta_p=factor * increment.delta_p)


def turning(increment: ImuIncrement) -> ImuIncrement:
    """Return the increment of a gyroscope that is 0.5 rad/s off."""
    return dataclasses.replace(
        increment, delta_R=increment.delta_R @ so3_exp(np.array([0.5, 0.0, 0.0]) * increment.dt_s)
    )


WRONG = {
    "sign": lambda increment: scaled(increment, -1.0),
    "g instead of m/s^2": lambda increment: scaled(increment, 1.0 / 9.81),
    "gravity removed": lambda increment: scaled(increment, 0.0),
    "rates": turning,
}


Flight = tuple[SlamStage, list[FrameOutput], list[str]]  # its stage, and the outputs and the fault after each frame


def add(to: Flight, features: StereoFeatures, increment: ImuIncrement | None) -> None:
    stage, outputs, faults = to
    stage.add_features(features)
    if increment is not None:
        stage.add_increment(increment)
    outputs += stage.run()
    faults.append(stage.imu_fault)


@pytest.fixture(scope="module")
def begun(flown) -> Callable[[int], Flight]:
    """What returns a flight of a seed up to the first wrong reading; each kind of fault goes on with a copy."""

    @functools.cache
    def fly_right(seed: int) -> Flight:
        flight = flown(seed, frames=FRAMES, tracked_px=SIGMA_PX)
        flying: Flight = flight.tracking_stage(SIGMA_PX), [], []
        for one in flight.frames[:FIRST]:
            add(flying, *one)
        return flying

    def go_on(seed: int) -> Flight:
        stage, outputs, faults = fly_right(seed)
        return copy_of(stage), outputs.copy(), faults.copy()

    return go_on


def fly_on(flying: Flight, flight, wrong, frames: range) -> tuple[list[FrameOutput], list[str]]:
    """Fly with wrong readings up to some frames; return the outputs, and the fault after each."""
    for k, (features, increment) in enumerate(flight.frames[FIRST:], start=FIRST):
        add(flying, features, None if increment is None else wrong(increment) if k in frames else increment)
    return flying[1:]


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRONG)
def test_an_imu_that_can_not_be_right_is_left_out_within_few_frames(flown, begun, kind: str) -> None:
    """Single flights were 300 m off at a sigma of 10 m."""
    ends, claimed = [], []
    for seed in SEEDS:
        flight = flown(seed, frames=FRAMES, tracked_px=SIGMA_PX)
        outputs, faults = fly_on(begun(seed), flight, WRONG[kind], range(FIRST, FRAMES))
        at = next(k for k, fault in enumerate(faults) if fault)
        assert FIRST + FAULTY_AFTER - 1 <= at <= FIRST + SLOWEST
        assert faults[-1]
        assert outputs[at].report.recovery == faults[at]
        assert not any(output.report.coasted or output.report.recovery for output in outputs[at + 1 :])
        errors_m, nees = flight.errors_and_nees(outputs)
        ends.append(errors_m[-1])
        claimed.append(nees[at:].mean())
    assert np.sqrt(np.mean(np.square(ends))) <= 10.0
    assert np.mean(claimed) <= 1.5


def test_an_imu_that_is_right_again_is_believed_again(flown, begun) -> None:
    flight = flown(310, frames=FRAMES, tracked_px=SIGMA_PX)
    outputs, faults = fly_on(begun(310), flight, WRONG["sign"], range(FIRST, FIRST + 8))
    assert any(faults)
    believed = len(faults) - faults[::-1].index(next(fault for fault in faults[::-1] if fault))
    assert believed <= FIRST + 8 + FAULTY_AFTER + HEALTHY_AFTER
    assert not any(output.report.coasted for output in outputs[believed:])
    _, nees = flight.errors_and_nees(outputs)
    assert nees[believed:].mean() <= 1.5


@pytest.mark.slow
def test_a_wrong_rig_or_start_is_no_fault_of_the_imu(flown) -> None:
    flight = flown(311, frames=FRAMES, tracked_px=SIGMA_PX)
    rig = flight.vehicle.rig
    turned = dataclasses.replace(rig.T_body_right, R=rig.T_body_right.R @ so3_exp(np.array([0.0, 0.02, 0.0])))
    knocked = dataclasses.replace(rig, T_body_right=turned)
    imu = flight.vehicle.scenario.imu_config
    stage = SlamStage(VehicleConfig(imu=imu), vehicle="uav1")
    stage.rig = knocked
    initial = flight.vehicle.initial
    fast = dataclasses.replace(initial.state, v_map=initial.state.v_map + np.array([8.0, 0.0, 0.0]))
    stage.start(dataclasses.replace(initial, state=fast))
    coasted = 0
    for features, increment in flight.frames:
        stage.add_features(features)
        if increment is not None:
            stage.add_increment(increment)
        coasted += sum(output.report.coasted for output in stage.run())
        assert stage.imu_fault == ""
    assert coasted > FAULTY_AFTER


def test_a_moment_of_high_acceleration_is_no_fault_of_the_imu() -> None:
    detector, upright = ImuFaultDetector(9.81), np.eye(3)
    samples = [ImuSample(k * 5_000_000, np.zeros(3), np.array([12.0, 0.0, 9.81])) for k in range(200)]
    zero = np.zeros(3)
    for k in range(20):
        span = k * 50_000_000, (k + 1) * 50_000_000
        pushed = preintegrate(samples, *span, gyro_bias=zero, accel_bias=zero, imu=ImuConfig())
        missed = 2 <= k < 9  # 0.35 s
        assert not detector.add(pushed, upright, coasted=missed, apart_rad=0.001)
        assert detector.is_suspected == missed


def test_a_single_wrong_rotation_of_the_images_is_no_fault_of_the_gyroscope() -> None:
    """A filter that is lost triangulates by a wrong calibration, now and then so that the rotation fits another one."""
    detector, upright, zero = ImuFaultDetector(9.81), np.eye(3), np.zeros(3)
    samples = [ImuSample(k * 5_000_000, zero, np.array([0.0, 0.0, 9.81])) for k in range(400)]
    for k, apart_rad in enumerate([0.004, 0.004, 0.24, 0.004, 0.004]):
        span = k * 140_000_000, (k + 1) * 140_000_000
        level = preintegrate(samples, *span, gyro_bias=zero, accel_bias=zero, imu=ImuConfig())
        assert not detector.add(level, upright, coasted=True, apart_rad=apart_rad), k
    assert detector.is_gyro_healthy


def test_images_that_stand_still_are_named_beside_the_gyroscope() -> None:
    """Frozen ones with noise, or ones of the vehicle itself, look like a gyroscope that is off."""
    detector, zero, rate = ImuFaultDetector(9.81), np.zeros(3), np.array([0.3, 0.0, 0.0])
    samples = [ImuSample(k * 5_000_000, rate, np.array([0.0, 0.0, 9.81])) for k in range(200)]
    for k in range(4):
        span = k * 140_000_000, (k + 1) * 140_000_000
        turned = preintegrate(samples, *span, gyro_bias=zero, accel_bias=zero, imu=ImuConfig())
        detector.add(turned, np.eye(3), coasted=True, apart_rad=0.3 * turned.dt_s)
    assert "0.3 rad/s" in detector.reason
    assert "that the images are live" in detector.reason


def test_while_images_show_nothing_a_fault_stays_as_it_is() -> None:
    detector, upright, zero = ImuFaultDetector(9.81), np.eye(3), np.zeros(3)
    samples = [ImuSample(k * 5_000_000, zero, np.array([0.0, 0.0, 9.81])) for k in range(4000)]
    span = itertools.pairwise(range(0, 4000 * 5_000_000, 100_000_000))
    level = [preintegrate(samples, *ends, gyro_bias=zero, accel_bias=zero, imu=ImuConfig()) for ends in span]
    upside_down = np.diag([1.0, -1.0, -1.0])
    assert not any(detector.add(one, upside_down, coasted=True, apart_rad=None) for one in level[:10])
    assert any(detector.add(one, upside_down, coasted=True, apart_rad=0.001) for one in level[10:12])
    for one in level[12 : 14 + HEALTHY_AFTER]:
        detector.add(one, upright, coasted=False, apart_rad=None)
    assert detector.reason
    for one in level[-HEALTHY_AFTER - 5 :]:
        detector.add(one, upright, coasted=False, apart_rad=0.001)
    assert not detector.reason
