# SPDX-License-Identifier: Apache-2.0
"""A short flight over known landmarks, seen by an ideal front end: what a filter needs, frame by frame."""

import dataclasses
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig, ImuConfig
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.filters import BOUNDED, FILTERS
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.square_root import SquareRootBelief
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle
from uav_vslam.types import ImuIncrement, NavEstimate, NavState

Array = NDArray[np.float64]

FRAMES = 8
IN_VIEW = 12


@dataclass(frozen=True)
class Course:
    """Frames over one patch of ground; every landmark is seen in each of them."""

    vehicle: SimulatedVehicle
    increments: list[ImuIncrement]  # number k leads from frame k to k + 1
    landmarks: Array

    @property
    def rig(self) -> StereoRig:
        return self.vehicle.rig

    @property
    def imu(self) -> ImuConfig:
        return self.vehicle.scenario.imu_config

    @property
    def initial(self) -> NavEstimate:
        """The start with its drawn errors, biases among them."""
        return self.vehicle.initial

    def true_state(self, frame: int) -> NavState:
        return self.vehicle.true_state(int(self.vehicle.frame_stamps_ns[frame]))

    def pixels(self, frame: int, rows: list[int] | Array, rng: np.random.Generator | None = None) -> Array:
        """Return (M, 4) pixels of some landmarks as the true camera sees them, with 1 px of noise from `rng`."""
        T_left_map = (self.true_state(frame).T_map_body @ self.rig.T_body_left).inverse()
        z = self.rig.project(T_left_map.apply(self.landmarks[np.asarray(rows, int)]))
        return z if rng is None else z + rng.normal(0.0, 1.0, z.shape)

    def filter(self, model: str = "ri15", name: str = "eif", **options: Any) -> Filter:
        """Return a filter of `FILTERS` at its start."""
        if name in BOUNDED:
            options.setdefault("gamma", BackendConfig().gamma)
        return FILTERS[name](self.initial, rig=self.rig, imu=self.imu, model=model, **options)

    def flown(self, model: str = "ri15", name: str = "eif", frames: int = 3, **options: Any) -> Filter:
        """Return a filter with correlated landmarks, just predicted to frame `frames`."""
        rng = np.random.default_rng(11)
        f = self.filter(model, name, **options)
        f.add_landmarks(self.pixels(0, np.arange(IN_VIEW), rng))
        for frame in range(1, frames + 1):
            f.predict(self.increments[frame - 1])
            if frame < frames:
                f.update(np.arange(IN_VIEW), self.pixels(frame, np.arange(IN_VIEW), rng))
        return f

    @staticmethod
    def set_covariance(f: Filter, P: Array) -> None:
        """Give a filter another covariance, in the form that it keeps."""
        kept = {CovarianceBelief: lambda: P, SquareRootBelief: lambda: np.linalg.cholesky(P)}
        kept[InformationBelief] = lambda: np.linalg.inv(P)
        f.belief = type(f.belief)(kept[type(f.belief)](), f.vehicle)


@pytest.fixture(scope="session")
def course() -> Course:
    scenario = dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, seed=5)
    vehicle = simulate_vehicle(scenario, 0)
    samples = vehicle.imu.samples()
    stamps = vehicle.frame_stamps_ns
    zero = np.zeros(3)
    increments = [
        preintegrate(samples, int(a), int(b), gyro_bias=zero, accel_bias=zero, imu=scenario.imu_config)
        for a, b in itertools.pairwise(stamps)
    ]
    rng = np.random.default_rng(2)
    middle: Pose = vehicle.true_state(int(stamps[FRAMES // 2])).T_map_body
    below = middle.t[:2] + rng.uniform(-9, 9, (IN_VIEW, 2))
    return Course(vehicle, increments, np.column_stack([below, rng.normal(0, 3, IN_VIEW)]))
