# SPDX-License-Identifier: Apache-2.0
"""What the processes of a node graph need, from samples of the time that they have used."""

import os
import subprocess
import sys

import pytest

from uav_vslam.studies.live.compute import Sample, frame_rows, node_name, processor_rows, sample_children
from waiting import wait_for


def test_shares_are_over_the_time_of_the_flight_alone() -> None:
    samples = [Sample(float(t), {"replay": 3.0 + 0.1 * t, "uav1/fusion": 2.0 + 0.5 * t}) for t in range(11)]
    samples[0] = Sample(0.0, {"replay": 0.0, "uav1/fusion": 0.0})  # they had to start first
    samples.append(Sample(11.0, {"uav1/fusion": 90.0}))  # the flight is over
    rows = processor_rows(samples, "replay", 5.0, "x")
    shares = {row["method"]: row["core_share"] for row in rows}
    assert shares == {"replay": pytest.approx(0.1), "uav1/fusion": pytest.approx(0.5), "all": pytest.approx(0.6)}


def test_without_a_flight_there_are_no_shares() -> None:
    assert processor_rows([Sample(0.0, {})], "replay", 5.0, "x") == []


def test_frames_are_a_share_of_those_that_were_played() -> None:
    (row,) = frame_rows({"uav1": 99}, 100, "x")
    assert row["processed_share"] == pytest.approx(0.99)


def test_a_node_is_named_by_its_namespace() -> None:
    assert node_name(["python", "-r", "__node:=fusion", "-r", "__ns:=/uav1"]) == "uav1/fusion"
    assert node_name(["python", "-r", "__node:=replay", "-r", "__ns:=/"]) == "replay"
    assert node_name(["sleep", "1"]) == ""


def test_children_are_seen_with_the_time_that_they_have_used() -> None:
    busy = [sys.executable, "-c", "while True: pass", "__ns:=/uav1", "__node:=busy"]
    with subprocess.Popen(busy) as child:
        try:
            assert wait_for(lambda: sample_children(os.getpid(), 0.0).cpu_s.get("uav1/busy", 0.0) > 0.0)
        finally:
            child.kill()
