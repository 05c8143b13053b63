# SPDX-License-Identifier: Apache-2.0
"""A short flight over known landmarks with an ideal front end: a filter's inputs, frame by frame."""

import dataclasses
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.config import BackendConfig, ImuConfig, RigConfig
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.filters import BOUNDED, FILTERS
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.observation import projectable
from uav_vslam.estimation.past_poses import PastPoses
from uav_vslam.estimation.square_root import SquareRootBelief
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, Purpose, SimulatedVehicle, simulate_vehicle
from uav_vslam.types import ImuIncrement, NavEstimate, NavState

Array = NDArray[np.float64]

FRAMES = 8
IN_VIEW = 12


@dataclass(frozen=True)
class Course:
    """Frames over one patch of ground; every landmark is seen in each of them."""

    vehicle: SimulatedVehicle
    increments: list[ImuIncrement]  # number k spans frames k to k + 1
    landmarks: Array

    @property
    def rig(self) -> StereoRig:
        return self.vehicle.rig

    @property
    def imu(self) -> ImuConfig:
        return self.vehicle.scenario.imu_config

    @property
    def initial(self) -> NavEstimate:
        """The start state with its random errors, biases included."""
        return self.vehicle.initial

    def true_state(self, frame: int) -> NavState:
        return self.vehicle.true_state(int(self.vehicle.frame_stamps_ns[frame]))

    def past_poses(self, frames: int, turning: Turning) -> PastPoses:
        """Return the true poses of the first frames."""
        past = PastPoses.none()
        for frame in range(frames):
            past = past.followed_by(self.true_state(frame), turning)
        return past

    def pixels(self, frame: int, rows: list[int] | Array, rng: np.random.Generator | None = None) -> Array:
        """Return (M, 4) true pixels of some landmarks, with 1 px of noise from `rng`."""
        T_left_map = (self.true_state(frame).T_map_body @ self.rig.T_body_left).inverse()
        z = self.rig.project(T_left_map.apply(self.landmarks[np.asarray(rows, int)]))
        return z if rng is None else z + rng.normal(0.0, 1.0, z.shape)

    def filter(self, model: str = "ri15", name: str = "eif", **options: Any) -> Filter:
        """Return a filter of `FILTERS` at the start state."""
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
        """Replace a filter's covariance, in the form of its belief."""
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


@dataclass(frozen=True)
class Outcome:
    """The end of a flight.

    Attributes:
        filter: final state.
        position_nees: divided by 3.
        nis_per_dof: mean over all frames.
    """

    filter: Filter
    position_nees: float
    nis_per_dof: float


def _fly(
    vehicle: SimulatedVehicle,
    rig: RigConfig | None = None,
    *,
    name: str = "eif",
    model: str = "ri15",
    sigma_px: float = 1.0,
    offset_s: float = 0.0,
    gamma: float | None = None,
) -> Outcome:
    """Fly over known points, querying the estimate at each frame as the back end does.

    Args:
        vehicle: its true rig sees the points, `offset_s` after the stamp, with a noise of `sigma_px`.
        rig: uncertainty of the calibration.
        name, model: of the filter.
        sigma_px: of each pixel coordinate.
        offset_s: true time offset.
        gamma: of a bounded filter; None for the default.
    """
    points = scatter_landmarks([vehicle], per_frame=20).points_world
    rng, imu, zero = vehicle.scenario.rng(0, Purpose.PIXELS), vehicle.scenario.imu_config, np.zeros(3)
    options = {"gamma": gamma or BackendConfig().gamma} if name in BOUNDED else {}
    f = FILTERS[name](
        vehicle.initial,
        rig=vehicle.rig,
        imu=imu,
        model=model,
        sigma_px=sigma_px,
        depth_sigma_ratio=BackendConfig().depth_sigma_ratio,
        rig_config=rig,
        **options,
    )
    samples, stamps = vehicle.imu.samples(), vehicle.frame_stamps_ns.tolist()
    known, nis, dof = np.zeros(0, np.int64), 0.0, 0
    for frame, stamp in enumerate(stamps):
        if frame:
            first, last = np.searchsorted(vehicle.imu.stamps_ns, stamps[frame - 1 : frame + 1])
            around = samples[first - 1 : last + 2]
            f.predict(preintegrate(around, stamps[frame - 1], stamp, gyro_bias=zero, accel_bias=zero, imu=imu))
        true_rig, t_s = vehicle.true_rig(frame), float(vehicle.truth.time_s(stamp)) + offset_s
        points_left = (vehicle.truth.pose(t_s) @ true_rig.T_body_left).inverse().apply(points)
        seen = np.flatnonzero(projectable(true_rig, points_left))
        z = true_rig.project(points_left[seen]) + rng.normal(0.0, sigma_px, (len(seen), 4))
        _, rows, places = np.intersect1d(known, seen, return_indices=True)
        innovation = f.update(rows, z[places])
        nis, dof = nis + innovation.nis, dof + innovation.dof
        f.marginalise(np.flatnonzero(~np.isin(known, seen)))
        fresh = ~np.isin(seen, known) & np.isfinite(f.rig.triangulate(z)).all(axis=1)
        fresh &= f.can_add_landmarks
        f.add_landmarks(z[fresh])
        known = np.append(known[np.isin(known, seen)], seen[fresh])
        estimate = f.nav_estimate()
    error = vehicle.true_state(stamps[-1]).T_map_body.t - estimate.state.T_map_body.t
    P = estimate.covariance[:3, :3]
    return Outcome(f, float(error @ np.linalg.solve(P, error)) / 3.0, nis / dof)


@pytest.fixture(scope="session")
def fly() -> Callable[..., Outcome]:
    """Function that flies a simulated vehicle to its last frame: `fly(vehicle, rig)`."""
    return _fly
