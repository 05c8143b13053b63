# SPDX-License-Identifier: Apache-2.0
"""A live fleet's state: rates follow the arrivals, what stops is noticed, the worst health comes first."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_vslam.monitor import (
    ERROR,
    OK,
    SILENT,
    SILENT_S,
    WARN,
    WINDOW_S,
    Claim,
    Fleet,
    Link,
    NodeReport,
    Stream,
    Vehicle,
)


def stream_of(rate_hz: float, count: int) -> tuple[Stream, float]:
    """Return a stream of regular arrivals, and the time of the last."""
    stream = Stream()
    for k in range(count):
        stream.arrived(100.0 + k / rate_hz)
    return stream, 100.0 + (count - 1) / rate_hz


def report(level: int = OK, text: str = "running", heard_s: float = 0.0, **values: str) -> NodeReport:
    return NodeReport(level, text, {key.replace("__", "/"): value for key, value in values.items()}, heard_s)


@given(st.floats(0.2, 400.0), st.floats(0.0, 0.99), st.integers(2, 500))
def test_the_rate_of_a_regular_stream_does_not_depend_on_when_it_is_read(
    rate_hz: float, part: float, count: int
) -> None:
    stream, last_s = stream_of(rate_hz, count)
    assert stream.rate_hz(last_s + part / rate_hz) == pytest.approx(rate_hz, rel=1e-6)


def test_a_rate_is_that_of_the_last_seconds() -> None:
    stream, last_s = stream_of(100.0, 1000)
    for k in range(1, 200):
        stream.arrived(last_s + k / 10.0)
    assert stream.rate_hz(last_s + 19.9) == pytest.approx(10.0, rel=0.03)


def test_a_rate_falls_as_soon_as_a_message_is_overdue() -> None:
    stream, last_s = stream_of(10.0, 200)
    rates = [stream.rate_hz(last_s + after_s) for after_s in (0.05, 0.5, 1.0, 2.0, 100.0)]
    assert rates == sorted(rates, reverse=True)
    assert rates[0] == pytest.approx(10.0)
    assert rates[-1] == pytest.approx(10.0 * (WINDOW_S + 0.1) / (WINDOW_S + 100.0), rel=0.02)


def test_nothing_has_no_rate_and_is_not_silent() -> None:
    stream = Stream()
    assert (stream.rate_hz(1.0), stream.age_s(1.0), stream.is_silent(1e9)) == (None, None, False)
    stream.arrived(2.0)
    assert (stream.rate_hz(2.5), stream.age_s(2.5)) == (None, 0.5)


@pytest.mark.parametrize(("rate_hz", "silent_after_s"), [(200.0, SILENT_S), (1.0, 5.0), (0.5, 10.0)])
def test_a_stream_is_silent_after_some_of_its_own_periods(rate_hz: float, silent_after_s: float) -> None:
    stream, last_s = stream_of(rate_hz, 5)
    assert not stream.is_silent(last_s + 0.99 * silent_after_s)
    assert stream.is_silent(last_s + 1.01 * silent_after_s)


def test_a_claim_is_that_of_the_evaluation() -> None:
    root = np.random.default_rng(3).normal(size=(6, 6))
    covariance = root @ root.T
    claim = Claim.of(covariance.ravel().tolist())
    assert claim.sigma_m == pytest.approx(np.sqrt(np.trace(covariance[:3, :3])))
    assert claim.sigma_heading_rad == pytest.approx(np.sqrt(covariance[5, 5]))


def test_drops_are_summed_over_the_nodes_by_reason() -> None:
    vehicle = Vehicle("uav1")
    vehicle.nodes = {
        "stereo_frontend": report(dropped__unpaired="2", frames="9", dropped__late="0"),
        "fusion": report(dropped__unpaired="1", dropped__checksum="7", mode="narrowband"),
    }
    assert list(vehicle.dropped.items()) == [("checksum", 7), ("unpaired", 3)]
    assert vehicle.mode == "narrowband"
    vehicle.link = Link("none", 0.0, None, ())
    assert vehicle.mode == "none"


def test_the_worst_health_comes_first_and_a_node_without_news_is_silent() -> None:
    fleet = Fleet()
    for name, node, level, heard_s in (
        ("uav1", "fusion", OK, 10.0),
        ("uav1", "slam_backend", OK, 5.0),
        ("uav2", "fusion", WARN, 10.0),
        ("uav2", "slam_backend", ERROR, 10.0),
    ):
        vehicle = fleet.vehicle(name)
        assert vehicle is not None
        vehicle.nodes[node] = report(level, heard_s=heard_s)
    now_s = 10.5
    found = [(one.vehicle, one.node, one.level) for one in fleet.health(now_s)]
    assert found == [
        ("uav2", "slam_backend", ERROR),
        ("uav1", "slam_backend", SILENT),
        ("uav2", "fusion", WARN),
        ("uav1", "fusion", OK),
    ]
    assert not fleet.vehicles["uav1"].is_silent(now_s)
    assert fleet.vehicles["uav1"].is_silent(now_s + SILENT_S)


def test_named_vehicles_alone_are_watched_and_awaited() -> None:
    fleet = Fleet(["uav2", "uav1"])
    assert fleet.vehicle("stranger") is None
    assert fleet.missing == ["uav2", "uav1"]
    first = fleet.vehicle("uav1")
    assert first is not None
    first.streams["imu"].arrived(1.0)
    assert (fleet.missing, fleet.is_complete) == (["uav2"], False)


def test_without_names_all_that_are_heard_are_watched_in_order() -> None:
    fleet = Fleet()
    assert not fleet.is_complete
    for name in ("uav2", "uav1"):
        vehicle = fleet.vehicle(name)
        assert vehicle is not None
        vehicle.streams["odometry"].arrived(1.0)
        assert fleet.vehicle(name) is vehicle
    assert list(fleet.vehicles) == ["uav1", "uav2"]
    assert fleet.is_complete
