# SPDX-License-Identifier: Apache-2.0
"""A rig declared rigid: wrong calibrations are detected, correct ones raise no warning."""

import functools
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri

from uav_vslam.config import BackendConfig, RigConfig, StartConfig, VehicleConfig
from uav_vslam.estimation.disparity_prior import BETWEEN
from uav_vslam.pipeline import VehiclePipeline
from uav_vslam.simulation.landmarks import LandmarkNoise, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.disparity_judge import JUDGED_AFTER_S
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.rig_monitor import FALSE_ALARM, MISCALIBRATED, RigMonitor

NOISE_PX = 0.5
LONG = 160  # frames


TURNED = {"extrinsic_bias_deg": (0.02, 0.0, 0.0)}  # about the disparity axis: 0.6 px
TRUSTED = RigConfig(disparity_sigma_px=0.0)  # a disparity without errors


@functools.cache
def reports(seed: int, rig: RigConfig, *, frames: int = 80, start: str = "given", **truth: Any) -> list[FrameReport]:
    scenario = Scenario(seed=seed, vehicles=1, frames=frames, **truth)
    vehicle = simulate_vehicle(scenario, 0)
    config = VehicleConfig(
        imu=scenario.imu_config, rig=rig, backend=BackendConfig(sigma_px=NOISE_PX), start=StartConfig(method=start)
    )
    initial = vehicle.initial if start == "given" else None
    pipeline = VehiclePipeline(initial, rig=vehicle.rig, config=config, vehicle="uav1")
    source = SimulatedSource(vehicle, scatter_landmarks([vehicle]), LandmarkNoise(sigma_px=NOISE_PX))
    return [output.report for output in pipeline.run(source.iter_events())]


def warnings_of(flight: list[FrameReport], rig: RigConfig) -> list[str]:
    monitor = RigMonitor(rig)
    return [text for report in flight if (text := monitor.add(report))]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "frames"), [(1, LONG), (2, 80)])
def test_a_correct_rig_raises_no_warning(seed: int, frames: int) -> None:
    flight = reports(seed, RigConfig(), frames=frames)
    assert max(r.rig_evidence for r in flight) > 0.0  # it was monitored
    assert warnings_of(flight, RigConfig()) == []


@pytest.mark.parametrize(
    ("bias_deg", "rig"),
    [((0.02, 0.0, 0.0), TRUSTED), ((0.0, 0.02, 0.0), RigConfig(disparity_sigma_px=0.0, epipolar_sigma_deg=0.002))],
)
def test_a_rig_rotated_by_many_sigmas_is_detected_once(bias_deg: tuple[float, float, float], rig: RigConfig) -> None:
    (warning,) = warnings_of(reports(1, rig, extrinsic_bias_deg=bias_deg), rig)
    assert "of 4" in warning
    assert "rig.flexing" in warning


@pytest.mark.slow
@pytest.mark.parametrize("error_px", [0.3, -0.3])
def test_a_wrong_disparity_is_detected_estimated_and_told_once(error_px: float) -> None:
    flight = reports(3, RigConfig(), frames=LONG, disparity_bias_px=error_px)
    (warning,) = warnings_of(flight, RigConfig())
    assert "disparity is off by" in warning
    last = flight[-1].disparity
    assert last is not None
    assert last.miscalibrated > MISCALIBRATED
    assert abs(last.mean_px - error_px) < 3.0 * last.sigma_px < 0.3


@pytest.mark.slow
def test_a_calibration_is_not_judged_in_the_first_seconds() -> None:
    flight = reports(3, RigConfig(), **TURNED)
    found = [r.disparity for r in flight if r.disparity]
    early = found[: int(JUDGED_AFTER_S * Scenario().frame_rate_hz)]
    assert {one.miscalibrated for one in early} == {RigConfig().miscalibrated_probability}
    assert max(abs(one.mean_px) for one in early) < 0.1 * abs(found[-1].mean_px)


@pytest.mark.slow
def test_corrections_of_an_unknown_tilt_are_no_evidence() -> None:
    """The consumer unit's accelerometer knows it to 1.1 degrees until the vehicle turns, after 8 s."""
    flight = reports(6, RigConfig(), start="in_flight", imu="consumer")
    assert max(r.disparity.miscalibrated for r in flight if r.disparity) <= RigConfig().miscalibrated_probability


def test_what_is_not_judged_yet_is_claimed_as_doubtful() -> None:
    """The first frames know no better than the prior; a right calibration is hardly doubted any more in the end."""
    rig = RigConfig()
    flight = reports(1, rig, frames=LONG)
    sigma = [r.disparity.sigma_px for r in flight if r.disparity]
    right_px, wrong_px, wrong = rig.disparity_sigma_px, rig.miscalibrated_sigma_px, rig.miscalibrated_probability
    not_wrong = (1.0 - BETWEEN) * right_px**2 + BETWEEN * right_px * wrong_px
    assert sigma[0] == pytest.approx(np.sqrt((1.0 - wrong) * not_wrong + wrong * wrong_px**2), rel=1e-3)
    assert sigma[-1] < 0.5 * sigma[0]


def test_a_doubted_calibration_is_uncertain_from_the_start() -> None:
    flight = reports(1, RigConfig(miscalibrated_probability=0.5), frames=3)
    assert flight[0].disparity is not None
    assert flight[0].disparity.sigma_px > 0.2


def test_a_disparity_error_of_known_size_is_detected_beyond_it() -> None:
    rig = RigConfig(disparity_sigma_px=0.05, miscalibrated_probability=0.0)
    (warning,) = warnings_of(reports(1, rig, **TURNED), rig)
    assert "of 5" in warning


@pytest.mark.slow
def test_a_focal_length_that_is_far_off_is_detected() -> None:
    (warning,) = warnings_of(reports(1, RigConfig(), focal_ratio_bias=0.03), RigConfig())
    assert "of 5" in warning


def test_a_flexing_rig_needs_no_warning() -> None:
    monitor = RigMonitor(RigConfig(flexing=True))
    flight = reports(1, TRUSTED, **TURNED)
    assert max(r.rig_evidence for r in flight) > chdtri(3, FALSE_ALARM)
    assert [monitor.add(r) for r in flight] == [""] * len(flight)
