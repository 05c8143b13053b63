# SPDX-License-Identifier: Apache-2.0
"""The node graph when its sensors' clock is set, a bag is played in a loop, or inner messages are stamped wrongly."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from lone_node import lone_node  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from node_flight import NodeFlight  # noqa: E402
from position_nees import position_nees  # noqa: E402

from uav_vslam.ros.convert import odometry_from_msg  # noqa: E402
from uav_vslam.simulation.scenario import SCENARIOS, SimulatedVehicle, simulate_vehicle  # noqa: E402
from uav_vslam.types import NS_PER_S  # noqa: E402

pytestmark = pytest.mark.ros
FRAMES = 24
Make = Callable[..., NodeFlight]


@pytest.fixture(scope="module")
def vehicle() -> SimulatedVehicle:
    return simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1), 0)


@pytest.fixture
def make(vehicle: SimulatedVehicle, domain_id: int) -> Iterator[Make]:
    """Return a factory of the nodes with parameters."""
    with lone_node(partial(NodeFlight, vehicle), domain_id) as made:
        yield made


def stamps_ns(messages: list[Odometry]) -> list[int]:
    return [odometry_from_msg(message).stamp_ns for message in messages]


def worst_nees(vehicle: SimulatedVehicle, messages: list[Odometry], offset_s: float) -> float:
    """Return the largest position NEES, per axis, of estimates whose stamps are off by an offset."""
    offset_ns = round(offset_s * NS_PER_S)
    poses = map(odometry_from_msg, messages)
    return max(position_nees(pose, vehicle.true_state(pose.stamp_ns - offset_ns)) for pose in poses)


@pytest.mark.slow
def test_a_bag_played_in_a_loop_is_flown_again_to_the_same_bits(make: Make) -> None:
    """Under use_sim_time, with a clock that jumps back and a start state that is published again."""
    flight = make("use_sim_time:=true", "session:=1")
    for _ in range(3):
        flight.start()
        flight.fly()
    expected = [features.stamp_ns for features in flight.features]
    assert stamps_ns(flight.odometry) == 3 * expected
    assert stamps_ns(flight.fused)[:FRAMES] == expected
    assert len(flight.fused) >= 3 * FRAMES - 2  # joint information tells of a new session, and may come after odometry
    first = [bytes(memoryview(np.array(m.pose.covariance))) for m in flight.odometry[:FRAMES]]
    for loop in (1, 2):
        again = flight.odometry[loop * FRAMES : (loop + 1) * FRAMES]
        assert [bytes(memoryview(np.array(m.pose.covariance))) for m in again] == first
    assert [node.counts["time_jumps"] for node in (flight.ins, flight.backend)] == [2, 2]
    assert not any(count for node in flight.nodes for key, count in node.counts.items() if "stamp" in key)


@pytest.mark.parametrize("offset_s", [-10.0, 10.0])
def test_a_clock_that_was_set_is_bridged(make: Make, vehicle: SimulatedVehicle, offset_s: float) -> None:
    flight = make("session:=1")
    flight.start()
    flight.fly(0, 12)
    flight.fly(12, imu_s=offset_s, images_s=offset_s)
    assert len(flight.odometry) == FRAMES
    assert worst_nees(vehicle, flight.odometry[:12], 0.0) <= 3.0
    assert worst_nees(vehicle, flight.odometry[12:], offset_s) <= 3.0
    assert f"the clock of IMU and image jumped by {offset_s + 0.1:+.1f} s" in flight.ins.notes["time_jump"]
    assert (flight.backend._stage.session == 1) == (offset_s > 0)


def test_where_the_clock_is_not_followed_the_diagnostics_name_it(make: Make) -> None:
    flight = make("input.on_time_jump:=refuse")
    flight.start()
    flight.fly(0, 8)
    flight.fly(8, 16, imu_s=-10.0, images_s=-10.0)
    assert len(flight.odometry) == 8
    assert flight.spin(lambda: "jump by -9." in getattr(flight.statuses.get("ins_propagator"), "message", ""))
    assert flight.statuses["ins_propagator"].level == b"\2"
    flight.fly(16)
    assert len(flight.odometry) == FRAMES - 8
    assert "clock" not in flight.ins.failures


@pytest.mark.parametrize("who", ["IMU", "image"])
def test_the_clock_of_one_sensor_alone_stops_odometry_and_is_named(make: Make, who: str) -> None:
    flight = make()
    flight.start()
    flight.fly(0, 5)
    flight.fly(5, 21, **({"imu_s": 10.0} if who == "IMU" else {"images_s": 10.0}))
    assert len(flight.odometry) == 5
    assert flight.ins.failures["clock"].startswith(f"{who} stamps jump by +10.")
    flight.fly(21)
    assert len(flight.odometry) > 5
    assert "clock" not in flight.ins.failures


@pytest.mark.slow
def test_inner_messages_from_the_future_stop_nothing(make: Make, vehicle: SimulatedVehicle) -> None:
    flight = make()
    flight.start()
    for first, last in ((0, 12), (12, 15), (15, 18), (18, FRAMES)):
        flight.fly(first, last)
        flight.disturb(flight.backend, "ins/increment", 60)
        flight.disturb(flight.backend, "stereo_features", 3600)
        flight.disturb(flight.fusion, "odometry", 3600)
        flight.disturb(flight.fusion, "joint_information", 3600)
        flight.disturb(flight.ins, "slam/correction", 3600)
    expected = [features.stamp_ns for features in flight.features]
    assert stamps_ns(flight.odometry) == stamps_ns(flight.fused) == expected
    assert worst_nees(vehicle, flight.odometry, 0.0) <= 3.0
    dropped = [node.counts["dropped/stamp_jump"] for node in (flight.backend, flight.fusion)]
    assert dropped == [6, 6]  # the last ones are not judged yet
    assert flight.ins.counts["dropped/stamp_ahead"] == 4
