# SPDX-License-Identifier: Apache-2.0
"""The noise of tracks is measured across epipolar lines, and a flight with noisier tracks stays as good and honest."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from uav_vslam.config import BackendConfig, ImuConfig, VehicleConfig
from uav_vslam.estimation.tracks import OFFSET
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.increments import unknown_motion_since
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.noise_monitor import NoiseMonitor
from uav_vslam.slam.stage import SlamStage
from uav_vslam.slam.track_noise import FRAMES, LEAST_POINTS, NOISE_RATIO, TrackNoise
from uav_vslam.types import NS_PER_S, ImuIncrement, NavState, StereoFeatures

CONFIGURED_PX = 0.07
FLIGHTS = 8


def frame(rig: StereoRig, sigma_px: float, *, count: int = 200, seed: int = 0, tracked: bool = True) -> StereoFeatures:
    """Return points at 20 to 80 m, the right pixel off from the left one as a track's is."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(20.0, 80.0, (count, 1))
    at = rng.uniform([0, 0], [rig.left.width, rig.left.height], (count, 2))
    pixels = rig.project(rig.left.bearings(at) * depth)
    pixels[:, 2:] += rng.normal(0.0, sigma_px * np.hypot(1.0, OFFSET), (count, 2))
    tracks = np.arange(1, count + 1, dtype=np.uint32) if tracked else np.zeros(count, np.uint32)
    return StereoFeatures(seed, pixels.astype(np.float32), np.zeros((count, 8), np.uint8), tracks)


def measured(rig: StereoRig, frames: list[StereoFeatures]) -> float:
    noise = TrackNoise()
    for features in frames:
        noise.add(features, rig)
    return noise.sigma_px(CONFIGURED_PX)


@pytest.fixture
def rig(flown) -> StereoRig:
    return flown(3, tracked_px=0.05).vehicle.rig


@pytest.mark.parametrize("sigma_px", [0.15, 0.4])
def test_noisier_tracks_are_measured(rig: StereoRig, sigma_px: float) -> None:
    frames = [frame(rig, sigma_px, seed=seed) for seed in range(FRAMES)]
    assert measured(rig, frames) == pytest.approx(sigma_px, rel=0.05)


def test_what_is_configured_counts_where_tracks_are_hardly_noisier(rig: StereoRig) -> None:
    for sigma_px in (0.3 * CONFIGURED_PX, CONFIGURED_PX, 0.9 * NOISE_RATIO * CONFIGURED_PX):
        assert measured(rig, [frame(rig, sigma_px, seed=seed) for seed in range(FRAMES)]) == CONFIGURED_PX


def test_wrong_matches_are_no_noise(rig: StereoRig) -> None:
    """Two of 40 points some pixels off bend a fit through all of them."""
    frames = []
    for seed in range(FRAMES):
        seen = frame(rig, CONFIGURED_PX, count=40, seed=seed)
        seen.pixels[:2, 2:] += np.random.default_rng(seed).uniform(2.0, 5.0, (2, 2))
        frames.append(seen)
    assert measured(rig, frames) == CONFIGURED_PX


def test_a_wrong_calibration_is_no_noise(rig: StereoRig) -> None:
    """A right camera turned by 0.05 degrees moves the epipolar lines by about a pixel."""
    turned = Pose(so3_exp(np.radians([0.05, 0.03, 0.05])), np.zeros(3))
    believed = dataclasses.replace(rig, T_body_right=rig.T_body_right @ turned)
    frames = [frame(rig, CONFIGURED_PX, seed=seed) for seed in range(FRAMES)]
    assert np.median(believed.epipolar_distance(frames[0].pixels)) > 10.0 * CONFIGURED_PX
    assert measured(believed, frames) == CONFIGURED_PX


@pytest.mark.parametrize("sigma_px", [0.05, 0.25])
def test_a_vibration_is_told_from_noise_and_from_a_wrong_calibration(rig: StereoRig, sigma_px: float) -> None:
    """A vibration by 0.02 degrees about each axis moves right points across their lines by 0.3 px."""
    rng, found = np.random.default_rng(7), []
    for vibration_deg in (0.0, 0.02):
        noise = TrackNoise()
        for seed in range(FRAMES):
            axis = np.radians(rng.normal([0.01, 0.02, 0.0], vibration_deg))
            turned = dataclasses.replace(rig, T_body_right=rig.T_body_right @ Pose(so3_exp(axis), np.zeros(3)))
            noise.add(frame(turned, sigma_px, seed=seed), rig)
        found.append(noise.vibration_px)
    shift_px = np.radians(0.02) * rig.right.fx
    assert found[0] < 0.3 * sigma_px
    assert found[1] == pytest.approx(shift_px, rel=0.5)


def test_false_matches_and_frames_with_few_tracks_do_not_count(rig: StereoRig) -> None:
    frames = [frame(rig, CONFIGURED_PX, seed=seed) for seed in range(FRAMES)]
    for features in frames:
        features.pixels[::10, 3] += 1.5
    few = frame(rig, 2.0, count=LEAST_POINTS - 1)
    assert measured(rig, [*frames, few, frame(rig, 2.0, tracked=False)]) == CONFIGURED_PX


def processed(stage: SlamStage, features: StereoFeatures, increment: ImuIncrement | None) -> list[FrameOutput]:
    if increment is not None:
        stage.add_increment(increment)
    stage.add_features(features)
    return list(stage.run())


def flights(flown, configured_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Return last position errors [m] and NEES per axis of flights with tracks of 0.25 px, and all warnings."""
    errors, nees, warnings = [], [], []
    for seed in range(FLIGHTS):
        flight = flown(100 + seed, tracked_px=0.25 / np.sqrt(2.0))
        backend = BackendConfig(sigma_px=0.25, track_sigma_px=configured_px)
        stage = SlamStage(VehicleConfig(imu=flight.vehicle.scenario.imu_config, backend=backend), vehicle="uav1")
        stage.rig = flight.vehicle.rig
        stage.start(flight.vehicle.initial)
        outputs = []
        for one in flight.frames:
            outputs.extend(processed(stage, *one))
        assert len(outputs) == len(flight.frames)
        error, consistency = flight.errors_and_nees(outputs)
        errors.append(error[-1])
        nees.append(consistency[-1])
        warnings.extend(text for output in outputs for text in output.warnings)
    return np.array(errors), np.array(nees), warnings


@pytest.mark.slow
def test_a_flight_with_noisier_tracks_is_as_good_as_if_that_were_configured(flown) -> None:
    told, _, _ = flights(flown, 0.25)
    errors, nees, warnings = flights(flown, CONFIGURED_PX)
    assert np.sqrt(np.mean(errors**2)) < 1.1 * np.sqrt(np.mean(told**2))
    assert nees.mean() < chi2.ppf(0.975, 3 * FLIGHTS) / (3 * FLIGHTS)
    assert not any("calibration" in text for text in warnings)


def test_noisier_tracks_are_named_once() -> None:
    monitor = NoiseMonitor(ImuConfig())
    said = [monitor.add_tracks(sigma_px, configured_px=CONFIGURED_PX) for sigma_px in (CONFIGURED_PX, 0.21, 0.3)]
    assert said[0] == said[2] == ""
    assert "0.21 px off their epipolar lines, 3.0 times backend.track_sigma_px" in said[1]


def test_noisier_readings_are_named_once_by_what_they_settle_at() -> None:
    """The first spectrum of noise that begins is quiet in part."""
    imu = ImuConfig()
    state = NavState(0, Pose.identity(), np.zeros(3), np.zeros(3), np.zeros(3))
    monitor, motion = NoiseMonitor(imu), unknown_motion_since(state, NS_PER_S // 8, imu)
    times = [1.0, 5.0, 1.0, 3.0, *[6.0] * 20]
    said = [monitor.add(dataclasses.replace(motion, accel_noise=ratio * imu.accel_noise)) for ratio in times]
    assert [k for k, text in enumerate(said) if text] == [10]
    assert "6.0 times imu.accel_noise" in said[10]


def test_a_noise_that_is_configured_in_flight_is_not_taken_for_a_measured_one(flown) -> None:
    flight = flown(100, tracked_px=0.05)
    stage = flight.tracking_stage(0.05)
    warnings = []
    for number, one in enumerate(flight.frames):
        if number == 5:
            backend = BackendConfig(sigma_px=0.05, track_sigma_px=0.5)
            stage.configure(VehicleConfig(imu=flight.vehicle.scenario.imu_config, backend=backend))
        warnings.extend(text for output in processed(stage, *one) for text in output.warnings)
    assert not any("epipolar" in text for text in warnings)
