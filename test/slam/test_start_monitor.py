# SPDX-License-Identifier: Apache-2.0
"""A start many sigmas off is detected within seconds; a correct one raises no warning."""

import dataclasses
import functools

import numpy as np
import pytest
from fed_stage import feed

from uav_vslam.config import BackendConfig, VehicleConfig
from uav_vslam.config.vehicle import START_METHODS, StartConfig
from uav_vslam.estimation.weighted_update import Innovation
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import VELOCITY
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import MIN_FEATURES
from uav_vslam.slam.stage import SlamStage
from uav_vslam.slam.start_monitor import (
    MAX_COASTED,
    NEGLIGIBLE,
    WATCHED_S,
    StartMonitor,
    velocity_correction,
)
from uav_vslam.types import NS_PER_S, NavEstimate, NavState, StereoFeatures

REMEDY = "check initial_state and its covariance, the IMU (units, axes, noise), the clocks and the calibration"
ZERO = np.zeros(3)
FRAMES = 24  # 3.2 s
VELOCITY_SIGMA, TILT_SIGMA_DEG, YAW_SIGMA_DEG = 0.1, 0.2, 0.5  # of a simulated start


def stage_of(flight, method: str = "given", **backend: float) -> SlamStage:
    imu, start = flight.vehicle.scenario.imu_config, StartConfig(method=method)
    stage = SlamStage(VehicleConfig(imu=imu, start=start, backend=BackendConfig(**backend)), vehicle="uav1")
    stage.rig = flight.vehicle.rig
    return stage


def warnings_of(flight, initial: NavEstimate, method: str = "given") -> list[str]:
    """Fly from a start state and return the warnings."""
    return [text for output in outputs_of(stage_of(flight, method), flight, initial) for text in output.warnings]


def outputs_of(stage: SlamStage, flight, initial: NavEstimate) -> list[FrameOutput]:
    """Fly from a start state."""
    stage.start(initial)
    return feed(stage, flight.frames)


def moved(initial: NavEstimate, *, velocity=ZERO, rotation_deg=ZERO) -> NavEstimate:
    state = initial.state
    pose = Pose(so3_exp(np.deg2rad(rotation_deg)) @ state.T_map_body.R, state.T_map_body.t)
    return NavEstimate(dataclasses.replace(state, T_map_body=pose, v_map=state.v_map + velocity), initial.covariance)


def with_wrong_track(features: StereoFeatures, frame: int) -> StereoFeatures:
    """Add a point that jumps about, on a track of four frames."""
    pixels = np.random.default_rng(frame).uniform(100.0, 800.0, (1, 4)).astype(np.float32)
    return StereoFeatures(
        features.stamp_ns,
        np.vstack([features.pixels, pixels]),
        np.vstack([features.descriptors, features.descriptors[:1]]),
        np.append(features.tracks, np.uint32(9000 + frame // 4)),
    )


def test_tracks_that_all_began_with_the_first_frame_are_no_evidence_against_it(flown) -> None:
    """As in hover: they fill the window in one frame, and the next one's views say nothing yet."""
    flight = flown(1, frames=40, frame_rate_hz=100.0, tracked_px=0.05)
    lasting = functools.reduce(np.intersect1d, [features.tracks for features, _ in flight.frames])
    frames = tuple(
        (with_wrong_track(features.chosen(np.flatnonzero(np.isin(features.tracks, lasting))), frame), step)
        for frame, (features, step) in enumerate(flight.frames)
    )
    hover = dataclasses.replace(flight, frames=frames)
    outputs = outputs_of(stage_of(hover, window_spacing_s=0.0), hover, flight.vehicle.initial)
    assert len(lasting) >= MIN_FEATURES
    assert [k for k, output in enumerate(outputs) if output.report.coasted] == [11, 22, 33]  # MAX_COASTED of them
    assert not any(output.report.recovery or output.warnings for output in outputs)


@pytest.mark.parametrize("seed", range(1, 11))
def test_a_correct_start_raises_no_warning(flown, seed: int) -> None:
    flight = flown(seed)
    assert warnings_of(flight, flight.vehicle.initial) == []


WRONG = {
    "forward velocity": {"velocity": np.array([10 * VELOCITY_SIGMA, 0.0, 0.0])},
    "vertical velocity": {"velocity": np.array([0.0, 0.0, -10 * VELOCITY_SIGMA])},
    "all velocities": {"velocity": 10 * VELOCITY_SIGMA * np.array([1.0, -1.0, 1.0])},
    "heading": {"rotation_deg": np.array([0.0, 0.0, 10 * YAW_SIGMA_DEG])},
    # ten sigmas of roll are seven with the accelerometer's bias included: too few for every flight
    "tilt": {"rotation_deg": np.array([20 * TILT_SIGMA_DEG, 0.0, 0.0])},
}


@pytest.mark.parametrize("seed", range(1, 4))
@pytest.mark.parametrize("what", WRONG)
def test_a_start_many_sigmas_off_is_detected_once(flown, what: str, seed: int) -> None:
    flight = flown(seed)
    warnings = warnings_of(flight, moved(flight.vehicle.initial, **WRONG[what]))
    assert all(text.endswith(REMEDY) for text in warnings)
    restarts = [text.startswith("the filter was re-initialised") for text in warnings]
    assert restarts in ([False], [True], [False, True])  # what is found, what is done about it, or both


# Where points are tracked: less tilt shows, but a forward velocity may be taken for a wrong calibration.
FAR = {what: WRONG[what] for what in ("vertical velocity", "all velocities", "heading")}
FAR["tilt"] = {"rotation_deg": np.array([10 * TILT_SIGMA_DEG, 0.0, 0.0])}
FAR["said to be slow"] = {"velocity": np.array([-10.0, 0.0, 0.0])}
FAR["said to be at rest"] = {"velocity": np.array([-20.0, 0.0, 0.0])}


@pytest.mark.parametrize("what", FAR)
def test_after_a_wrong_start_the_estimate_claims_no_more_than_it_knows(flown, what: str) -> None:
    flight = flown(1, frames=48, tracked_px=0.05)
    outputs = outputs_of(flight.tracking_stage(0.05), flight, moved(flight.vehicle.initial, **FAR[what]))
    assert sum(output.report.recovery != "" for output in outputs) == 1
    assert flight.errors_and_nees(outputs)[1][20:].mean() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("what", ["vertical velocity", "all velocities", "heading", "tilt"])
def test_after_a_wrong_start_landmarks_alone_claim_no_more_either(flown, what: str) -> None:
    nees = []
    for flight in (flown(seed, frames=48) for seed in (1, 2, 3)):
        outputs = outputs_of(stage_of(flight), flight, moved(flight.vehicle.initial, **WRONG[what]))
        assert sum(output.report.recovery != "" for output in outputs) == 1
        nees.append(flight.errors_and_nees(outputs)[1][20:].mean())
    assert np.mean(nees) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("disparity_px", [-0.6, 0.6])
def test_a_wrong_calibration_that_explains_the_first_frames_is_estimated_and_told(flown, disparity_px: float) -> None:
    flight = flown(2, frames=60, tracked_px=0.05)
    stage = flight.tracking_stage(0.05)
    stage.rig = flight.vehicle.rig.disparity_shifted(disparity_px)
    outputs = outputs_of(stage, flight, flight.vehicle.initial)
    of_start, of_rig = (text for output in outputs for text in output.warnings)
    assert of_start.endswith(REMEDY)
    assert of_rig.startswith("the motion contradicts the calibration of the cameras: the disparity is off by")
    assert not any(output.report.recovery for output in outputs)
    disparity = outputs[-1].report.disparity
    assert disparity is not None
    assert abs(disparity.mean_px + disparity_px) < 0.1
    assert flight.errors_and_nees(outputs)[1][25:].mean() < 2.0


def test_a_start_that_was_not_recorded_is_not_sought_in_the_recording(flown) -> None:
    flight = flown(1)
    (warning,) = warnings_of(flight, moved(flight.vehicle.initial, **WRONG["forward velocity"]), "static")
    assert "at rest, imu.gyro_bias_sigma and imu.accel_bias_sigma, the IMU (units, axes, noise)" in warning
    assert "initial_state" not in warning


@pytest.mark.parametrize("method", START_METHODS)
def test_each_method_of_a_start_has_its_remedy(method: str) -> None:
    monitor = StartMonitor(method)
    warning = [monitor.add(report(0.1 * k), DEAD_RECKONED) for k in range(MAX_COASTED + 1)][-1]
    assert ("initial_state" in warning) == (method == "given")


def report(second: float, *, innovation=None, features: int = 50, landmarks: int = 50, velocity=ZERO) -> FrameReport:
    state = NavState(round(second * NS_PER_S), Pose.identity(), velocity, ZERO, ZERO)
    nav = NavEstimate(state, 0.01 * np.eye(15))
    return FrameReport(nav.pose, nav, features, 0, False, innovation, landmarks)


DEAD_RECKONED = NavEstimate(NavState(0, Pose.identity(), ZERO, ZERO, ZERO), 0.05 * np.eye(15))
GOOD = Innovation(100.0, 100)


def test_innovations_that_are_too_large_as_a_whole_are_detected() -> None:
    monitor = StartMonitor()
    assert monitor.add(report(0.0), DEAD_RECKONED) == ""
    assert monitor.add(report(0.1, innovation=GOOD), DEAD_RECKONED) == ""
    warning = monitor.add(report(0.2, innovation=Innovation(1700.0, 100)), DEAD_RECKONED)
    assert warning == f"innovations after the start are 3.0 times larger than the start's sigmas allow; {REMEDY}"
    assert monitor.add(report(0.3, innovation=Innovation(1700.0, 100)), DEAD_RECKONED) == ""  # once


def test_frames_with_features_but_no_association_are_detected() -> None:
    monitor = StartMonitor()
    warnings = [monitor.add(report(0.1 * k), DEAD_RECKONED) for k in range(MAX_COASTED + 1)]
    assert warnings[:-1] == [""] * MAX_COASTED  # at the first frame the map is empty
    assert warnings[-1].startswith(f"{MAX_COASTED} of the first frames show nothing where")


def test_frames_with_tracks_of_which_none_is_used_are_detected_without_any_landmark() -> None:
    monitor = StartMonitor()
    frames = [dataclasses.replace(report(0.1 * k, landmarks=0), tracked=50 if k else 0) for k in range(MAX_COASTED + 1)]
    warnings = [monitor.add(frame, DEAD_RECKONED) for frame in frames]
    assert warnings[:-1] == [""] * MAX_COASTED
    assert warnings[-1].startswith(f"{MAX_COASTED} of the first frames show nothing where")


@pytest.mark.parametrize("poor", [{"features": 5}, {"landmarks": 5}])
def test_frames_with_few_features_or_landmarks_are_no_evidence(poor) -> None:
    monitor = StartMonitor()
    assert not any(monitor.add(report(0.1 * k, **poor), DEAD_RECKONED) for k in range(20))


def test_later_faults_are_not_attributed_to_the_start() -> None:
    monitor = StartMonitor()
    assert monitor.add(report(0.0), DEAD_RECKONED) == ""
    later = WATCHED_S + 0.1
    assert monitor.add(report(later, innovation=Innovation(1e4, 100), velocity=np.ones(3)), DEAD_RECKONED) == ""


def test_a_correction_is_scaled_by_the_reduction_of_covariance() -> None:
    P_dead_reckoned, P = np.diag([0.29] * 15), np.diag([0.04] * 15)
    nav = NavEstimate(dataclasses.replace(DEAD_RECKONED.state, v_map=np.array([1.0, 1.0, 1.0])), P)
    times = velocity_correction(nav, NavEstimate(DEAD_RECKONED.state, P_dead_reckoned))
    np.testing.assert_allclose(times, 2.0, rtol=1e-3)  # 1 m/s are two of sqrt(0.29 - 0.04)
    # A filter less certain than dead reckoning reduced nothing: only a centimetre per second is tolerated.
    uncertain = velocity_correction(nav, NavEstimate(DEAD_RECKONED.state, 0.01 * np.eye(15)))
    np.testing.assert_allclose(uncertain, 100.0, rtol=1e-3)


def test_a_correction_is_whitened_by_the_reduction_of_covariance_as_a_whole() -> None:
    rng = np.random.default_rng(4)
    A, d = rng.normal(size=(15, 15)), rng.normal(size=3)
    nav = NavEstimate(dataclasses.replace(DEAD_RECKONED.state, v_map=d), np.eye(15))
    times = velocity_correction(nav, NavEstimate(DEAD_RECKONED.state, np.eye(15) + A @ A.T))
    S = (A @ A.T)[VELOCITY, VELOCITY] + NEGLIGIBLE**2 * np.eye(3)
    np.testing.assert_allclose(times, np.sqrt(d @ np.linalg.solve(S, d) / 3), rtol=1e-9)


def test_a_speed_is_no_evidence_where_the_calibration_may_be_wrong() -> None:
    dead_reckoned = dataclasses.replace(DEAD_RECKONED.state, v_map=np.array([20.0, 0.0, 0.0]))
    faster, sideways = (dataclasses.replace(dead_reckoned, v_map=np.array(v)) for v in ([22.0, 0, 0], [20.0, 2.0, 0]))
    P, none = np.eye(15), np.zeros((15, 15))
    of = {name: NavEstimate(state, none) for name, state in (("faster", faster), ("sideways", sideways))}
    before = NavEstimate(dead_reckoned, P)
    assert velocity_correction(of["faster"], before, scaled=True) == pytest.approx(0.0, abs=1e-9)
    assert velocity_correction(of["sideways"], before, scaled=True) == pytest.approx(2.0 / np.sqrt(2.0), rel=1e-3)


def test_a_start_is_trusted_after_the_watch_and_never_after_a_warning() -> None:
    good, bad = StartMonitor(), StartMonitor()
    after_ns = round((WATCHED_S + 0.1) * NS_PER_S)
    assert good.add(report(0.0), DEAD_RECKONED) == ""
    assert bad.add(report(0.0, velocity=np.ones(3)), DEAD_RECKONED) != ""
    assert not good.trusts(round(WATCHED_S * NS_PER_S))
    assert good.trusts(after_ns)
    assert not bad.trusts(after_ns)
