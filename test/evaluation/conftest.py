# SPDX-License-Identifier: Apache-2.0
"""Trajectories with known errors."""

from collections.abc import Callable

import numpy as np
import pytest

from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation, rotation_from_rpy, so3_exp

START_NS = 1_700_000_000_000_000_007  # not a whole second: a float would lose the last digits


def make_truth(count: int = 120, period_ns: int = 100_000_000) -> Trajectory:
    """Return a climbing turn of 20 m/s that starts at START_NS."""
    stamps_ns = START_NS + period_ns * np.arange(count, dtype=np.int64)
    t = period_ns * 1e-9 * np.arange(count)
    yaw = 0.15 * t
    positions = np.stack([20 / 0.15 * np.sin(yaw), 20 / 0.15 * (1 - np.cos(yaw)), 70 + 0.5 * t], axis=1)
    R = rotation_from_rpy(0.1 * np.sin(t), 0.05 * np.cos(t), yaw)
    return Trajectory(stamps_ns, positions, quaternion_wxyz_from_rotation(R))


def perturb(truth: Trajectory, rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> Trajectory:
    """Return an estimate with independent errors drawn from its covariance."""
    covariance = np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    positions = truth.positions + rng.normal(0, sigma_m, truth.positions.shape)
    R = so3_exp(rng.normal(0, sigma_rad, truth.positions.shape)).transpose(0, 2, 1) @ truth.rotations
    return Trajectory(
        truth.stamps_ns, positions, quaternion_wxyz_from_rotation(R), np.tile(covariance, (len(truth), 1, 1))
    )


def make_vehicle(name: str, rng: np.random.Generator, *, peer: bool = True, truth_known: bool = True) -> VehicleResult:
    """Return a vehicle whose INS errs by 4 m, S-SLAM by 1 m and C-SLAM by 0.5 m on each axis."""
    truth = make_truth()
    return VehicleResult(
        name=name,
        truth=truth if truth_known else None,
        ins=perturb(truth, rng, 4.0, 0.02),
        s_slam=perturb(truth, rng, 1.0, 0.01),
        c_slam=perturb(truth, rng, 0.5, 0.01) if peer else None,
        frames_in=121,
        frames_processed=120,
        link=LinkCounters(1234.5, 12, 11, 10, {"stale": 1}) if peer else LinkCounters(),
    )


@pytest.fixture
def truth() -> Trajectory:
    """The climbing turn."""
    return make_truth()


@pytest.fixture
def estimate(truth: Trajectory) -> Trajectory:
    """The climbing turn with errors of 1 m and 0.02 rad."""
    return perturb(truth, np.random.default_rng(7), 1.0, 0.02)


@pytest.fixture
def perturbed() -> Callable[..., Trajectory]:
    """The function `perturb`."""
    return perturb


@pytest.fixture
def flight() -> FlightResult:
    """Two cooperating vehicles."""
    rng = np.random.default_rng(1)
    vehicles = {name: make_vehicle(name, rng) for name in ("uav1", "uav2")}
    return FlightResult("pair flight", 3, "wideband", 12.0, 24.0, vehicles, {"uav1": {"backend": {"sigma_px": 1.0}}})


@pytest.fixture
def single_flight() -> FlightResult:
    """One vehicle without peer or ground truth."""
    vehicle = make_vehicle("uav1", np.random.default_rng(2), peer=False, truth_known=False)
    return FlightResult("alone", None, "none", 12.0, 0.0, {"uav1": vehicle})
