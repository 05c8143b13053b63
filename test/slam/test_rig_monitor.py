# SPDX-License-Identifier: Apache-2.0
"""A rig declared rigid: wrong calibrations are detected, correct ones raise no warning."""

import pytest
from scipy.special import chdtri

from uav_vslam.config import BackendConfig, RigConfig, VehicleConfig
from uav_vslam.pipeline import VehiclePipeline
from uav_vslam.simulation.landmarks import LandmarkNoise, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.backend import FrameReport
from uav_vslam.slam.rig_monitor import FALSE_ALARM, RigMonitor

NOISE_PX = 0.5


def reports(bias_deg: tuple[float, float, float], seed: int, rig: RigConfig) -> list[FrameReport]:
    scenario = Scenario(seed=seed, vehicles=1, frames=80, extrinsic_bias_deg=bias_deg)
    vehicle = simulate_vehicle(scenario, 0)
    config = VehicleConfig(imu=scenario.imu_config, rig=rig, backend=BackendConfig(sigma_px=NOISE_PX))
    pipeline = VehiclePipeline(vehicle.initial, rig=vehicle.rig, config=config, vehicle="uav1")
    source = SimulatedSource(vehicle, scatter_landmarks([vehicle]), LandmarkNoise(sigma_px=NOISE_PX))
    return [output.report for output in pipeline.run(source.iter_events())]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_correct_rig_raises_no_warning(seed: int) -> None:
    flight = reports((0.0, 0.0, 0.0), seed, RigConfig())
    assert max(r.rig_evidence for r in flight) > 0.0  # it was monitored
    monitor = RigMonitor(RigConfig())
    assert [monitor.add(r) for r in flight] == [""] * len(flight)


@pytest.mark.parametrize(
    ("bias_deg", "rig"),
    [((0.02, 0.0, 0.0), RigConfig()), ((0.0, 0.02, 0.0), RigConfig(epipolar_sigma_deg=0.002))],
)
def test_a_rig_rotated_by_many_sigmas_is_detected_once(bias_deg: tuple[float, float, float], rig: RigConfig) -> None:
    monitor = RigMonitor(rig)
    warnings = [text for r in reports(bias_deg, 1, rig) if (text := monitor.add(r))]
    assert len(warnings) == 1
    assert "of 3" in warnings[0]
    assert "rig.disparity_sigma_px" in warnings[0]
    assert "rig.flexing" in warnings[0]


def test_a_constant_disparity_error_is_estimated_without_a_warning() -> None:
    """Turned about the disparity axis by 0.02 degrees, 0.6 px, two sigma; with the rig exact, that is a warning."""
    rig = RigConfig(disparity_sigma_px=0.3)
    monitor = RigMonitor(rig)
    assert [text for r in reports((0.02, 0.0, 0.0), 1, rig) if (text := monitor.add(r))] == []


def test_a_disparity_error_beyond_its_sigma_is_detected() -> None:
    rig = RigConfig(disparity_sigma_px=0.05)
    monitor = RigMonitor(rig)
    warnings = [text for r in reports((0.02, 0.0, 0.0), 1, rig) if (text := monitor.add(r))]
    assert len(warnings) == 1
    assert "of 4" in warnings[0]


def test_a_flexing_rig_needs_no_warning() -> None:
    monitor = RigMonitor(RigConfig(flexing=True))
    flight = reports((0.02, 0.0, 0.0), 1, RigConfig())
    assert max(r.rig_evidence for r in flight) > chdtri(3, FALSE_ALARM)
    assert [monitor.add(r) for r in flight] == [""] * len(flight)
