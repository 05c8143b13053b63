# SPDX-License-Identifier: Apache-2.0
"""The view of a live fleet shows each figure in its place, in narrow terminals too."""

import io

import pytest
from rich.console import Console

from uav_vslam.monitor import ERROR, OK, WARN, Claim, Fleet, Link, NodeReport, Peer, Stream
from uav_vslam.report.live_table import live_lines, live_view

NOW_S = 100.0


def flying(*, silent: bool = False) -> Fleet:
    """Return two vehicles; the second was last heard half a minute ago if it is silent."""
    fleet = Fleet(["uav1", "uav2"])
    for k, vehicle in enumerate(fleet.vehicles.values()):
        end_s = NOW_S - 30.0 if silent and k else NOW_S
        for rate_hz, stream in zip((200.0, 50.0, 7.0, 6.5, 6.0), vehicle.streams.values(), strict=True):
            for step in range(10, -1, -1):
                stream.arrived(end_s - step / rate_hz)
        vehicle.own, vehicle.fused = Claim(1.25, 0.1), Claim(0.75, 0.01)
        vehicle.on_frame(landmarks=88, coasted=True)
        peer = Peer(f"uav{2 - k}", 9, 6, 2, 1300.0, 11, 1.5, silent=not k and silent)
        vehicle.link = Link("narrowband", 4321.0, 6000.0, (peer,))
        vehicle.nodes["slam_backend"] = NodeReport(OK, "running", {"dropped/late": "3"}, end_s)
    return fleet


def shown(fleet: Fleet, width: int = 120) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(live_view(fleet, NOW_S))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def rows(text: str, name: str) -> list[list[str]]:
    """Return the cells of the tables' rows, which alone are indented."""
    return [line.split() for line in text.splitlines() if line.startswith(f" {name}")]


@pytest.mark.parametrize("width", [80, 120])
def test_each_figure_is_in_its_row(width: int) -> None:
    estimates, radio, *_ = rows(shown(flying(), width), "uav1")
    assert estimates == ["uav1", "200.0", "50.0", "7.0", "6.5", "6.0", "1.250", "0.750", "0.573", "88"]
    assert radio[:3] == ["uav1", "narrowband", "4.32"]
    if width == 120:
        assert radio[3:] == ["(6.00", "with", "headers)", "uav2", "1.30", "9", "6", "2", "11", "1.5"]


def test_what_is_sent_has_a_unit_as_what_is_received_has() -> None:
    assert shown(flying(), 80).count("[kB/s]") == 2


def test_a_radio_of_which_nothing_is_known_yet_is_not_said_to_receive_nothing() -> None:
    fleet = flying()
    alone, unknown = fleet.vehicles.values()
    alone.link, unknown.link = Link("wideband", 0.0, None, ()), None
    assert [rows(shown(fleet), name)[1][3:] for name in ("uav1", "uav2")] == [["none", "received"], ["–"]]


def test_nodes_that_are_well_are_counted_and_drops_named() -> None:
    text = shown(flying())
    assert "all 2 nodes that report are well" in text
    assert "uav1 dropped 3 late" in text
    assert "uav2 coasted 1 of 1 frames" in text


@pytest.mark.parametrize("width", [80, 120])
def test_a_stopped_stream_shows_for_how_long(width: int) -> None:
    fleet = flying()
    vehicle = fleet.vehicles["uav1"]
    for stream in ("imu", "ins", "features", "odometry", "fused"):
        vehicle.streams[stream] = Stream()
        vehicle.streams[stream].arrived(80.0)
    text = shown(fleet, width)
    assert rows(text, "uav1")[0] == ["uav1", *["0"] * 5, "1.250", "0.750", "0.573", "88"]
    assert text.count("(20 s)") == 5
    assert "IMU 0 (20 s), INS 0 (20 s)" in live_lines(fleet, NOW_S)[0]


def test_a_vehicle_that_stops_keeps_its_last_claims_and_shows_its_age() -> None:
    text = shown(flying(silent=True))
    assert "uav2 silent for 30 s" in text
    assert rows(text, "uav2")[0] == ["uav2", *["–"] * 5, "1.250", "0.750", "0.573", "88"]
    assert "uav2 (silent)" in text  # as the peer of uav1
    assert "uav2 slam_backend" not in text


def test_the_worst_node_is_named_first() -> None:
    fleet = flying()
    fleet.vehicles["uav1"].nodes["fusion"] = NodeReport(WARN, "uav2 silent for 9 s", {}, NOW_S)
    fleet.vehicles["uav2"].nodes["fusion"] = NodeReport(ERROR, "no calibration", {}, NOW_S)
    lines = shown(fleet).splitlines()
    assert lines.index("error: uav2 fusion: no calibration") + 1 == lines.index(
        "warning: uav1 fusion: uav2 silent for 9 s"
    )


def test_what_is_awaited_is_named() -> None:
    assert "waiting for a vehicle" in shown(Fleet())
    assert "waiting for uav7: nothing received" in shown(Fleet(["uav7"]))


def test_lines_have_the_same_figures_and_a_line_for_each_fault() -> None:
    lines = live_lines(flying(silent=True), NOW_S)
    assert "IMU 200.0" in lines[0]
    assert "1σ own 1.250, fused 0.750 m, heading 0.573 deg; landmarks 88; narrowband, sent 4.32" in lines[0]
    assert lines[0].endswith("received 1.30 kB/s")
    assert "uav2 silent for 30 s" in lines
