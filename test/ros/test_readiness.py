# SPDX-License-Identifier: Apache-2.0
"""A replay starts only after mutual discovery of all publishers and subscriptions."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="needs ROS")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from uav_vslam.ros.readiness import READERS, UNMATCHED, Readiness

BACKEND = "uav1: slam_backend"


class Observer:
    """The graph as the replay node sees it."""

    def __init__(
        self,
        *,
        publishers: dict[str, int],
        subscribers: dict[str, int],
        node: tuple[str, str] = ("/uav1", "slam_backend"),
    ) -> None:
        self._publishers, self._subscribers = publishers, subscribers
        self._namespace, self._name = node

    def create_subscription(self, _kind, _topic, callback, _depth) -> None:
        self.receive = callback

    def get_publishers_info_by_topic(self, _topic: str) -> list[SimpleNamespace]:
        return [SimpleNamespace(node_namespace=self._namespace, node_name=self._name)]

    def count_publishers(self, topic: str) -> int:
        return self._publishers.get(topic, 0)

    def count_subscribers(self, topic: str) -> int:
        return self._subscribers.get(topic, 0)


def missing(observer: Observer, *reports: dict[str, str]) -> list[str]:
    readiness = Readiness(observer, ["uav1"])
    for report in reports:
        values = [KeyValue(key=key, value=value) for key, value in report.items()]
        observer.receive(DiagnosticArray(status=[DiagnosticStatus(name=BACKEND, values=values)]))
    return readiness.missing()


def test_a_node_that_has_not_reported_is_waited_for() -> None:
    assert missing(Observer(publishers={}, subscribers={})) == [f"{BACKEND} has not reported"]


def test_a_node_whose_name_is_not_yet_discovered_is_waited_for() -> None:
    unnamed = Observer(publishers={}, subscribers={}, node=("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_"))
    assert len(missing(unnamed)) == 1


def test_foreign_nodes_are_not_waited_for() -> None:
    assert missing(Observer(publishers={}, subscribers={}, node=("/gcs", "monitor"))) == []


def test_a_publisher_that_a_node_has_not_found_is_waited_for_if_there_is_one() -> None:
    observer = Observer(publishers={"/uav1/stereo_features": 1}, subscribers={})
    found = missing(observer, {UNMATCHED: "/uav1/stereo_features /uav1/never_published"})
    assert found == [f"{BACKEND} has not found the publisher of /uav1/stereo_features"]


def test_a_subscription_that_a_publisher_has_not_found_is_waited_for() -> None:
    observer = Observer(publishers={}, subscribers={"/uav1/odometry": 3, "/uav1/path": 1})
    found = missing(observer, {UNMATCHED: "", READERS: "/uav1/odometry=2 /uav1/path=1 /tf=0"})
    assert found == [f"{BACKEND} has not found every reader of /uav1/odometry"]


def test_the_newest_report_counts() -> None:
    observer = Observer(publishers={}, subscribers={"/uav1/odometry": 3})
    early, late = {UNMATCHED: "", READERS: "/uav1/odometry=2"}, {UNMATCHED: "", READERS: "/uav1/odometry=3"}
    assert missing(observer, early, late) == []
