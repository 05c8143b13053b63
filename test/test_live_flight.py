# SPDX-License-Identifier: Apache-2.0
"""Live odometry of a whole flight: corrections come late, the output goes on in between and stays consistent."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_log
from uav_vslam.ins.body_twist import body_twist
from uav_vslam.ins.imu_statistics import ImuStatistics
from uav_vslam.ins.live_odometry import LiveOdometry
from uav_vslam.pipeline import VehiclePipeline
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState

pytestmark = pytest.mark.slow

LATENCY_NS = NS_PER_S // 10  # of a correction after its image
SEEDS = (1, 2, 3)


@dataclasses.dataclass(frozen=True)
class Output:
    """One output of the live odometry, and the truth at its stamp."""

    nav: NavEstimate
    T_odom_body: Pose
    twist_linear: np.ndarray
    twist_sigma: np.ndarray
    truth: NavState


def fly(seed: int) -> list[Output]:
    scenario = dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=160, imu="consumer", seed=seed)
    (simulated,) = simulate_fleet(scenario)
    source, config = SimulatedSource(simulated, scatter_landmarks([simulated])), VehicleConfig(imu=scenario.imu_config)
    pipeline = VehiclePipeline(source.initial_state, rig=source.rig, config=config, vehicle="uav1")
    corrections = [output.report.nav for output in pipeline.run(source.iter_events())]
    statistics, outputs = ImuStatistics(config.imu), []
    live = LiveOdometry(source.initial_state, config.imu, statistics, period_s=0.02)
    for sample in (event for event in source.iter_events() if isinstance(event, ImuSample)):
        while corrections and corrections[0].state.stamp_ns + LATENCY_NS <= sample.stamp_ns:
            live.correct(corrections.pop(0))
        statistics.add(sample)
        if live.add_imu(sample):
            twist = body_twist(live.estimate, live.increment)
            truth = simulated.true_state(sample.stamp_ns)
            sigma = np.sqrt(np.diag(twist.covariance)[:3])
            outputs.append(Output(live.estimate, live.T_odom_body, twist.linear, sigma, truth))
    return outputs


@pytest.fixture(scope="module")
def flights() -> list[list[Output]]:
    return [fly(seed) for seed in SEEDS]


def nees(errors: np.ndarray, covariances: np.ndarray) -> float:
    """Return the mean of the squared error over the claimed covariance, per axis."""
    return float(np.mean(np.einsum("ki,kij,kj->k", errors, np.linalg.inv(covariances), errors)) / errors.shape[1])


def test_position_velocity_and_attitude_are_consistent_at_imu_stamps(flights: list[list[Output]]) -> None:
    outputs = [output for flight in flights for output in flight]
    P = np.array([output.nav.covariance for output in outputs])
    state = [output.nav.state for output in outputs]
    truth = [output.truth for output in outputs]
    position = np.array([b.T_map_body.t - a.T_map_body.t for a, b in zip(state, truth, strict=True)])
    velocity = np.array([b.v_map - a.v_map for a, b in zip(state, truth, strict=True)])
    rotation = np.array([so3_log(b.T_map_body.R @ a.T_map_body.R.T) for a, b in zip(state, truth, strict=True)])
    assert 0.3 < nees(position, P[:, 0:3, 0:3]) < 3.0
    assert 0.3 < nees(velocity, P[:, 3:6, 3:6]) < 3.0
    assert 0.3 < nees(rotation, P[:, 6:9, 6:9]) < 3.0


def test_the_twist_is_consistent_in_the_body_frame(flights: list[list[Output]]) -> None:
    z = [
        (output.truth.T_map_body.R.T @ output.truth.v_map - output.twist_linear) / output.twist_sigma
        for flight in flights
        for output in flight
    ]
    assert 0.3 < np.mean(np.square(z)) < 3.0


def motion_errors_m(flight: list[Output], span: int) -> list[float]:
    """Return the errors of the motion over `span` outputs, in the odometry frame."""
    errors = []
    for first, last in zip(flight, flight[span:], strict=False):
        moved = first.T_odom_body.inverse() @ last.T_odom_body
        true = first.truth.T_map_body.inverse() @ last.truth.T_map_body
        errors.append(float(np.linalg.norm(moved.t - true.t)))
    return errors


def test_motion_in_the_odometry_frame_errs_by_less_than_half_a_metre_in_two_seconds(
    flights: list[list[Output]],
) -> None:
    """Corrections of a whole flight, tens of metres against pure inertial navigation, never show as a step."""
    span = 100  # outputs: 2 s
    for flight in flights:
        assert max(motion_errors_m(flight, span)) < 0.5
        assert max(motion_errors_m(flight, 1)) < 0.02  # half a metre a second of wrong velocity, no jump of position
