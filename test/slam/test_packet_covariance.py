# SPDX-License-Identifier: Apache-2.0
"""A packet's covariance bounds the sender's despite rounding, and hardly exceeds it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigh

from uav_vslam.config import RigConfig, VehicleConfig
from uav_vslam.geometry.coded_points import OFFSET_STEP_M, AnchoredPoints, rigid_jacobian
from uav_vslam.pipeline import VehiclePipeline
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.packet.covariance import code_anchored, code_dense
from uav_vslam.types import JointInformation

Array = NDArray[np.float64]

FORMS = {"dense": code_dense, "anchor": code_anchored}
EIGENVALUE = 1e-12  # allowed above 1: the encoder keeps a margin of 1e-9 for eigh's own error


def random_covariance(rng: np.random.Generator, n: int, decades: float) -> Array:
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * 10.0 ** rng.uniform(-decades / 2, decades / 2, n)) @ Q.T
    return np.asarray(0.5 * (P + P.T))


def largest_ratio(exact: Array, coded: Array) -> float:
    """Return lambda_max(R^-1 P): the largest ratio of exact to encoded variance."""
    return float(eigh(exact, coded, eigvals_only=True)[-1])


@pytest.mark.parametrize("form", FORMS)
@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), decades=st.floats(0.0, 7.0), log_scale=st.floats(-6, 6)
)
def test_the_coded_covariance_bounds_the_exact_one(
    form: str, seed: int, count: int, decades: float, log_scale: float
) -> None:
    rng = np.random.default_rng(seed)
    P = 10.0**log_scale * random_covariance(rng, 3 * count, decades)
    points, scale = FORMS[form](rng.uniform(-100, 100, (count, 3)), P)
    assert largest_ratio(P, scale * points.covariance) <= 1.0 + EIGENVALUE
    assert scale >= 1.0


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 64), decades=st.floats(0.0, 6.0))
def test_single_precision_costs_a_dense_packet_nothing(seed: int, count: int, decades: float) -> None:
    P = random_covariance(np.random.default_rng(seed), 3 * count, decades)
    _, scale = code_dense(np.zeros((count, 3)), P)
    assert scale <= 1.0 + 1e-6 * 10.0 ** (decades / 2)  # float32 rounds by 6e-8 of the largest


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("relative_m", [0.1, 0.03, 0.003])
def test_landmarks_that_share_the_drift_of_their_map_are_bounded(form: str, relative_m: float) -> None:
    rng = np.random.default_rng(0)
    drift = np.tile(np.eye(3), (20, 1))
    P = drift @ drift.T + relative_m**2 * np.diag(rng.uniform(0.5, 2.0, 60))
    points, scale = FORMS[form](rng.uniform(-100, 100, (20, 3)), P)
    assert largest_ratio(P, scale * points.covariance) <= 1.0 + EIGENVALUE


@pytest.mark.parametrize("form", FORMS)
def test_no_landmarks_have_no_covariance(form: str) -> None:
    points, scale = FORMS[form](np.zeros((0, 3)), np.zeros((0, 0)))
    assert (points.covariance.shape, points.offsets_m.shape, scale) == ((0, 0), (0, 3), 1.0)


def test_rounded_positions_stay_within_half_a_step_and_add_their_variance() -> None:
    rng = np.random.default_rng(1)
    offsets = rng.uniform(-655, 655, (50, 3))
    points, scale = code_anchored(offsets[:9], 1e-6 * np.eye(27))  # far more certain than the code can represent
    R = scale * points.covariance
    assert np.abs(points.offsets_m - offsets[:9]).max() <= OFFSET_STEP_M / 2 + 1e-9
    assert largest_ratio((1e-6 + OFFSET_STEP_M**2 / 12) * np.eye(27), R) <= 1.0 + EIGENVALUE


def test_rounding_inflates_each_landmark_separately() -> None:
    """One flat ellipsoid, as of a landmark seen once, is coarsely rounded; the others must not be inflated."""
    P = 0.3**2 * np.eye(18)
    P[:3, :3] = np.diag([0.04, 0.04, 8.0]) ** 2
    points, scale = code_anchored(np.random.default_rng(2).uniform(-50, 50, (6, 3)), P)
    assert scale < 1.01
    assert (np.diagonal(scale * points.covariance)[3:] < 1.1 * 0.3**2).all()


def fly(rig: RigConfig) -> list[JointInformation]:
    """Return the filter's joint information, once a second, on a flight over simulated landmarks."""
    scenario = Scenario(frames=50)
    vehicle = simulate_vehicle(scenario, 0)
    source = SimulatedSource(vehicle, scatter_landmarks([vehicle]))
    config = VehicleConfig(imu=scenario.imu_config, rig=rig)
    pipeline = VehiclePipeline(vehicle.initial, rig=vehicle.rig, config=config, vehicle=vehicle.name)
    return [output.joint for output in pipeline.run(source.iter_events()) if output.joint is not None]


@pytest.fixture(scope="module")
def joints() -> list[JointInformation]:
    return fly(RigConfig())


@pytest.fixture(scope="module")
def joints_of_trusted_rig() -> list[JointInformation]:
    return fly(RigConfig(miscalibrated_probability=0.0))


@pytest.mark.parametrize("form", FORMS)
def test_the_filters_own_covariances_are_bounded_and_hardly_scaled(joints: list[JointInformation], form: str) -> None:
    rng = np.random.default_rng(3)
    assert len(joints) >= 6
    for joint in joints:
        exact = np.linalg.inv(joint.information)
        rows = np.sort(rng.choice(len(joint.ids), 14, replace=False))
        columns = (6 + 3 * rows[:, None] + np.arange(3)).ravel()
        P, offsets = exact[np.ix_(columns, columns)], joint.positions[rows] - joint.positions[rows].mean(axis=0)
        points, scale = FORMS[form](offsets, P)
        assert largest_ratio(P, scale * points.covariance) <= 1.0 + EIGENVALUE
        assert scale < 1.001


@pytest.mark.parametrize("name", ["joints_of_trusted_rig", "joints"])
def test_the_compact_form_keeps_the_informative_part(name: str, request: pytest.FixtureRequest) -> None:
    """The shift that 14 landmarks have in common, with 0.3 m of each one's own added: 1 % more of its sigma at most.

    Most of what is not rigid is scale: without it in the common error, it was up to 30 % more.
    """
    floor = 0.3**2 * np.eye(42)
    for joint in request.getfixturevalue(name)[1:]:
        P = np.linalg.inv(joint.information)[6:48, 6:48]
        offsets = joint.positions[:14] - joint.positions[:14].mean(axis=0)
        points, scale = code_anchored(offsets, P)
        assert isinstance(points, AnchoredPoints)
        J = rigid_jacobian(offsets)
        sigma = [
            np.sqrt(np.trace(np.linalg.inv(J.T @ np.linalg.solve(A + floor, J))[:3, :3]))
            for A in (P, scale * points.covariance)
        ]
        assert sigma[1] < 1.01 * sigma[0]
