# SPDX-License-Identifier: Apache-2.0
"""A back end that goes on from a checkpoint ends where the one that never stopped does."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import ConfigError
from uav_vslam.ins.preintegrator import ImuPreintegrator
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.backend import SKIPPED_IDS
from uav_vslam.slam.checkpoint import load_checkpoint, save_checkpoint
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import ImuIncrement, ImuSample, StereoFeatures

Inputs = list[ImuIncrement | StereoFeatures]
SAVED, KILLED = 10, 16  # frames after which the checkpoint is written, and the process dies


@pytest.fixture(scope="module")
def source() -> SimulatedSource:
    (simulated,) = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], vehicles=1, frames=30))
    return SimulatedSource(simulated, scatter_landmarks([simulated]))


@pytest.fixture(scope="module")
def inputs(source: SimulatedSource) -> Inputs:
    """The features and increments of the flight, in the order in which they arrive."""
    preintegrator, arrived = ImuPreintegrator(VehicleConfig().imu, source.initial_state.state), []
    for event in source.iter_events():
        if isinstance(event, ImuSample):
            preintegrator.add_imu(event)
        else:
            arrived.append(event)
            if event.stamp_ns > preintegrator.start_ns:
                preintegrator.add_frame_stamp(event.stamp_ns)
        arrived += preintegrator.increments()
    return [*arrived, *preintegrator.increments(flush=True)]


def fresh(source: SimulatedSource) -> SlamStage:
    stage = SlamStage(VehicleConfig(), vehicle="uav1", session=7)
    stage.rig = source.rig
    stage.start(source.initial_state)
    return stage


def feed(stage: SlamStage, inputs: Inputs) -> list[FrameOutput]:
    outputs = []
    for one in inputs:
        stage.add_increment(one) if isinstance(one, ImuIncrement) else stage.add_features(one)
        outputs += stage.run()
    return outputs


def upto(inputs: Inputs, frames: int) -> int:
    """Return how many inputs the first frames are."""
    return [k for k, one in enumerate(inputs) if isinstance(one, StereoFeatures)][frames]


@pytest.fixture
def saved(source: SimulatedSource, inputs: Inputs, tmp_path: Path) -> Path:
    stage = fresh(source)
    feed(stage, inputs[: upto(inputs, SAVED)])
    save_checkpoint(tmp_path / "state" / "uav1.checkpoint", stage, "uav1")
    return tmp_path / "state" / "uav1.checkpoint"


def test_the_inputs_since_the_checkpoint_bring_it_back_to_the_same_estimate(
    source: SimulatedSource, inputs: Inputs, saved: Path
) -> None:
    undisturbed = feed(fresh(source), inputs)
    resumed = load_checkpoint(saved, "uav1")
    overlapping = inputs[upto(inputs, SAVED - 4) :]  # a durable topic repeats some that the checkpoint has seen
    outputs = feed(resumed, overlapping)
    assert [o.report.pose.stamp_ns for o in outputs] == [o.report.pose.stamp_ns for o in undisturbed[-len(outputs) :]]
    assert len(outputs) >= len(undisturbed) - SAVED
    for again, first in zip(outputs, undisturbed[-len(outputs) :], strict=True):
        np.testing.assert_array_equal(again.report.pose.T_map_body.matrix, first.report.pose.T_map_body.matrix)
        np.testing.assert_array_equal(again.report.pose.covariance, first.report.pose.covariance)


def test_it_stays_in_its_session_and_gives_out_no_identifier_twice(
    source: SimulatedSource, inputs: Inputs, saved: Path
) -> None:
    joints = [output.joint for output in feed(fresh(source), inputs) if output.joint is not None]
    resumed = load_checkpoint(saved, "uav1")
    again = [output.joint for output in feed(resumed, inputs[upto(inputs, SAVED - 4) :]) if output.joint is not None]
    assert again[-1].session == joints[-1].session == 7
    known = {int(id_) for joint in joints for id_ in joint.ids}
    new = {int(id_) for id_ in again[-1].ids if id_ >= SKIPPED_IDS}
    assert new
    assert not new & known


def test_inputs_that_were_lost_meanwhile_cost_certainty(source: SimulatedSource, inputs: Inputs, saved: Path) -> None:
    undisturbed = feed(fresh(source), inputs)
    outputs = feed(load_checkpoint(saved, "uav1"), inputs[upto(inputs, KILLED) :])
    first = outputs[0].report.pose
    same = next(o.report.pose for o in undisturbed if o.report.pose.stamp_ns == first.stamp_ns)
    error = first.T_map_body.t - same.T_map_body.t
    assert np.trace(first.covariance[:3, :3]) > np.trace(same.covariance[:3, :3])
    assert error @ np.linalg.solve(first.covariance[:3, :3], error) < 16.0


def test_a_start_long_before_the_first_known_motion_is_not_taken_for_the_present(
    source: SimulatedSource, inputs: Inputs
) -> None:
    stage = fresh(source)
    assert feed(stage, inputs[upto(inputs, 20) :]) == []
    assert stage.dropped["start_too_old"] > 0


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "no checkpoint to resume from"),
        (lambda path: path.write_bytes(path.read_bytes()[:500]), "damaged"),
        (lambda path: path.write_bytes(b""), "damaged"),
    ],
)
def test_a_missing_or_damaged_checkpoint_is_refused(saved: Path, damage, message: str) -> None:
    damage(saved)
    with pytest.raises(ConfigError, match=message):
        load_checkpoint(saved, "uav1")


def test_the_checkpoint_of_another_vehicle_is_refused(saved: Path) -> None:
    with pytest.raises(ConfigError, match="is of uav1"):
        load_checkpoint(saved, "uav2")
