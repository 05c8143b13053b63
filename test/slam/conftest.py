# SPDX-License-Identifier: Apache-2.0
"""A simulated flight as input of the back end: each frame's features with the increment up to it."""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from increment_error import shifted
from numpy.typing import ArrayLike, NDArray
from position_nees import position_nees

from uav_vslam.config import BackendConfig, RigConfig, VehicleConfig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import NS_PER_S, ImuIncrement, StereoFeatures


@dataclass(frozen=True)
class Flown:
    """A vehicle and its frames; the first has no increment."""

    vehicle: SimulatedVehicle
    frames: tuple[tuple[StereoFeatures, ImuIncrement | None], ...]

    def with_gyro_bias(self, bias: ArrayLike) -> list[tuple[StereoFeatures, ImuIncrement | None]]:
        """Return the frames with increments of readings that contain a further bias, to first order."""
        return [(features, step and shifted(step, -step.bias_jacobian[:, :3] @ bias)) for features, step in self.frames]

    def with_late_images(self, late_s: float) -> list[tuple[StereoFeatures, ImuIncrement | None]]:
        """Return the frames with increments by readings stamped as by a clock that the images' is behind of."""
        samples, late_ns, zero = self.vehicle.imu.samples(), round(late_s * NS_PER_S), np.zeros(3)
        frames = []
        for features, step in self.frames:
            if step is not None:
                ends = step.start_ns + late_ns, step.stamp_ns + late_ns
                imu = self.vehicle.scenario.imu_config
                moved = preintegrate(samples, *ends, gyro_bias=zero, accel_bias=zero, imu=imu)
                step = dataclasses.replace(moved, start_ns=step.start_ns, stamp_ns=step.stamp_ns)
            frames.append((features, step))
        return frames

    def tracking_stage(self, sigma_px: float, *, readout_s: float = 0.0) -> SlamStage:
        """Return a stage that has rig and start state, for points with tracks of that noise."""
        backend = BackendConfig(sigma_px=sigma_px, track_sigma_px=2.0 * sigma_px)
        rig = RigConfig(readout_s=readout_s)
        config = VehicleConfig(imu=self.vehicle.scenario.imu_config, backend=backend, rig=rig)
        stage = SlamStage(config, vehicle="uav1")
        stage.rig = self.vehicle.rig
        stage.start(self.vehicle.initial)
        return stage

    def errors_and_nees(self, outputs: list[FrameOutput]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the position error [m] and NEES per axis of each frame."""
        errors, nees = [], []
        for pose in (output.report.pose for output in outputs):
            truth = self.vehicle.true_state(pose.stamp_ns)
            errors.append(np.linalg.norm(pose.T_map_body.t - truth.T_map_body.t))
            nees.append(position_nees(pose, truth))
        return np.array(errors), np.array(nees)


def _tracked(vehicle: SimulatedVehicle, noise: LandmarkNoise) -> list[StereoFeatures]:
    """Return features whose tracks follow the landmarks that they show; a landmark missed in a frame gets a new one."""
    frames, numbers, lost = [], {}, 0
    for features, ids in observe(vehicle, scatter_landmarks([vehicle]), noise=noise):
        old, numbers = numbers, {}
        for identity in ids.tolist():
            lost += identity not in old
            numbers[identity] = old.get(identity, lost)
        frames.append(dataclasses.replace(features, tracks=np.array([numbers[i] for i in ids.tolist()], np.uint32)))
    return frames


@functools.cache
def _flown(
    seed: int,
    *,
    frames: int = 24,
    imu: str = "adis16480",
    tracked_px: float | None = None,
    readout_s: float = 0.0,
    **truth: float,
) -> Flown:
    scenario = dataclasses.replace(SCENARIOS["kagaru"], seed=seed, frames=frames, vehicles=1, imu=imu, **truth)
    vehicle = simulate_vehicle(scenario, 0)
    samples, zero = vehicle.imu.samples(), np.zeros(3)
    steps = [
        preintegrate(samples, int(a), int(b), gyro_bias=zero, accel_bias=zero, imu=scenario.imu_config)
        for a, b in itertools.pairwise(vehicle.frame_stamps_ns)
    ]
    if tracked_px is None:
        features = [seen for seen, _ in observe(vehicle, scatter_landmarks([vehicle]))]
    else:
        features = _tracked(vehicle, LandmarkNoise(sigma_px=tracked_px, readout_s=readout_s))
    return Flown(vehicle, tuple(zip(features, [None, *steps], strict=True)))


@pytest.fixture(scope="session")
def flown() -> Callable[..., Flown]:
    """Return a factory of flights: `flown(seed, frames=24, imu="adis16480", tracked_px=None, readout_s=0, **truth)`.

    `truth` is what else differs from the scenario `kagaru`.

    With `tracked_px`, the standard deviation of each pixel coordinate, the points have tracks, and the cameras may have
    a rolling shutter.
    """
    return _flown
