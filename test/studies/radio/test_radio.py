# SPDX-License-Identifier: Apache-2.0
"""The figures of the study of the packet modes, from made-up flights; and the study itself on a short one."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from uav_vslam.cli import main as command
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.output import LATEST
from uav_vslam.evaluation.study import TABLE
from uav_vslam.studies.radio.compute import MODES, NARROWBAND, WIDEBAND, Run, packet_sizes, radio_rows

FRAMES = 16  # 2.1 s: epochs at 1 and 2 s, so that a packet of the first can be used in the second


def make_run(
    mode: str,
    s: float,
    c: float,
    *,
    seed: int = 1,
    rate: float = 880.0,
    sizes: tuple[int, ...] = (892, 892),
    **dropped: int,
) -> Run:
    """Return a run with errors s and c [m] and a payload rate [B/s]."""
    link = {"sent_bytes_per_s": rate, "packets_sent": 2, "packets_received": 2, "packets_used": 1, "dropped": dropped}
    own, fused = ({"ate_m": ate, "nees_position": ate} for ate in (s, c))
    return Run(mode, seed, {"s_slam": own, "c_slam": fused, "link": link}, sizes)


def table(rows: list[dict[str, Any]], heading: str) -> list[dict[str, Any]]:
    return [row for row in rows if row[TABLE] == heading]


@pytest.mark.parametrize(
    ("counters", "sizes"),
    [
        ([], ()),
        ([(0, 0), (1, 800), (1, 800), (2, 1692)], (800, 892)),  # nothing sent, then held back once
        ([(1, 800), (3, 2600)], (800, 1800)),  # a status was lost
    ],
)
def test_packets_are_as_large_as_the_steps_of_the_counter(
    counters: list[tuple[int, int]], sizes: tuple[int, ...]
) -> None:
    assert packet_sizes(counters) == sizes


def test_errors_are_pooled_over_vehicles_and_seeds_before_they_are_compared() -> None:
    wide = [make_run(WIDEBAND, 3.0, 1.0, sizes=(80_000,)), make_run(WIDEBAND, 4.0, 2.0, seed=2)]
    narrow = [make_run(NARROWBAND, 3.0, 2.0), make_run(NARROWBAND, 4.0, 3.0, seed=2)]
    rows = table(radio_rows(wide + narrow, 2), "Modes")
    own, fused_wide, fused_narrow = (math.sqrt(0.5 * (a**2 + b**2)) for a, b in ((3, 4), (1, 2), (2, 3)))
    assert [row["method"] for row in rows] == list(MODES)
    assert [row["s_slam_ate_rms_m"] for row in rows] == pytest.approx([own, own])
    assert [row["ratio_to_s_slam"] for row in rows] == pytest.approx([fused_wide / own, fused_narrow / own])
    assert [row["gain_kept_share"] for row in rows] == pytest.approx([1.0, (own - fused_narrow) / (own - fused_wide)])
    assert [row["nees_position"] for row in rows] == pytest.approx([1.5, 2.5])
    assert [row["packet_bytes_max"] for row in rows] == [80_000, 892]
    assert [(row["packets_sent"], row["packets_used"], row["failures"]) for row in rows] == [(4, 2, 0)] * 2


def test_a_seed_that_failed_in_one_mode_counts_in_none() -> None:
    runs = [make_run(WIDEBAND, 3.0, 1.0), make_run(NARROWBAND, 3.0, 2.0), make_run(WIDEBAND, 9.0, 9.0, seed=2)]
    wide, narrow = table(radio_rows(runs, 2), "Modes")
    assert (wide["s_slam_ate_rms_m"], narrow["s_slam_ate_rms_m"]) == (3.0, 3.0)
    assert (wide["failures"], narrow["failures"]) == (0, 1)
    assert len(table(radio_rows(runs, 2), "Flights")) == 3


def test_where_every_flight_failed_no_target_is_met() -> None:
    rows = radio_rows([], 1)
    assert [row["failures"] for row in table(rows, "Modes")] == [1, 1]
    assert {row["met"] for row in table(rows, "Targets")} == {"no"}


@pytest.mark.parametrize(
    ("rate", "size", "fused", "met"),
    [
        (900.0, 1399, 1.3, ["yes", "yes", "yes", "yes"]),
        (901.0, 1400, 1.31, ["yes", "no", "no", "no"]),
    ],
)
def test_targets_are_met_up_to_their_limits(rate: float, size: int, fused: float, met: list[str]) -> None:
    wide = make_run(WIDEBAND, 3.0, 1.0, rate=100_000.0, sizes=(99_000,))
    rows = radio_rows([wide, make_run(NARROWBAND, 3.0, fused, rate=rate, sizes=(size,))], 1)
    assert [row["met"] for row in table(rows, "Targets")] == met


def test_nothing_is_kept_of_a_gain_that_is_none() -> None:
    rows = radio_rows([make_run(WIDEBAND, 3.0, 3.1), make_run(NARROWBAND, 3.0, 3.5)], 1)
    assert [row["gain_kept_share"] for row in table(rows, "Modes")] == [None, None]
    assert table(rows, "Targets")[-1]["met"] == "no"


def test_what_was_dropped_is_told_by_reason() -> None:
    runs = [make_run(WIDEBAND, 3.0, 1.0), make_run(NARROWBAND, 3.0, 1.0, budget=2), make_run(NARROWBAND, 3, 1, late=1)]
    wide, narrow = table(radio_rows(runs, 1), "Modes")
    assert wide["packets_dropped"] == "none"
    assert narrow["packets_dropped"] == "2 budget, 1 late"


def test_a_graph_that_fails_is_told_and_stops_no_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def read_runs(estimates: Path, flight: Path, mode: str, seed: int) -> list[Run]:
        if (seed, mode) == (1, NARROWBAND):
            raise UavVslamError("the node graph failed")
        return [make_run(mode, 3.0, 1.0, seed=seed)]

    monkeypatch.setattr("uav_vslam.studies.radio.flights.read_runs", read_runs)
    monkeypatch.setattr("uav_vslam.studies.radio.flights.fly_graph", lambda fleet, _: fleet)
    monkeypatch.setattr("uav_vslam.studies.engine.node_graph.record", lambda *_, **__: None)
    assert command.main(["study", "radio", "--seeds", "2", "--results", str(tmp_path)]) == 0
    assert "seed 1, narrowband: the node graph failed" in capsys.readouterr().err
    rows = json.loads((tmp_path / LATEST / "study.json").read_text())["rows"]
    assert [row["failures"] for row in table(rows, "Modes")] == [0, 1]


@pytest.mark.ros
@pytest.mark.slow
def test_both_modes_fly_the_same_flight_through_the_graph(tmp_path: Path) -> None:
    options = ["--seeds", "1", "--frames", str(FRAMES), "--scale", "0.25", "--results", str(tmp_path)]
    assert command.main(["study", "radio", *options]) == 0
    wide, narrow = table(json.loads((tmp_path / LATEST / "study.json").read_text())["rows"], "Modes")
    assert (wide["failures"], narrow["failures"]) == (0, 0)
    assert wide["s_slam_ate_rms_m"] == narrow["s_slam_ate_rms_m"]  # to the last bit: nothing of the network enters it
    assert wide["packets_sent"] == 4  # two epochs of two vehicles
    assert narrow["packet_bytes_max"] < 1400 < wide["packet_bytes_max"]
