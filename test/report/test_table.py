# SPDX-License-Identifier: Apache-2.0
import io

from rich.console import Console

from uav_vslam.evaluation.summary import build_summary
from uav_vslam.report.table import link_line, print_summary


def printed(flight, alignment="none"):
    stream = io.StringIO()
    print_summary(build_summary(flight, git=None, alignment=alignment), Console(file=stream, width=100))
    return stream.getvalue()


def row(text, *cells):
    """Return the line that holds all the cells."""
    return [line for line in text.splitlines() if all(cell in line for cell in cells)]


def test_each_vehicle_and_the_fleet_has_its_rows(pair):
    text = printed(pair)
    assert row(text, "uav1", "INS", "30.0", "–")
    assert row(text, "S-SLAM", "1.158", "2.000")  # ramp to 2 m: 2 * sqrt(mean of squares)
    assert row(text, "pooled", "INS")
    assert row(text, "ATE [m]", "End [m]", "Position NEES")
    assert text.count("C-SLAM") == 3
    assert "test flight, mode wideband, seed 5, 9.9 s of flight, 3.00x real time" in text


def test_a_single_vehicle_has_neither_peer_nor_pool(single):
    text = printed(single)
    assert "pooled" not in text
    assert "C-SLAM" not in text
    assert "uav1: 198 m, 100 of 101 frames; no peer" in text


def test_the_link_line_shows_rates_and_drops(pair):
    line = link_line("uav2", build_summary(pair, git=None)["vehicles"]["uav2"])
    assert line == ("uav2: 198 m, 100 of 101 frames; sent 10 packets, 18.23 kB/s; received 9, used 8; dropped: 1 stale")


def test_an_alignment_is_named(pair):
    assert "aligned (se3)" in printed(pair, alignment="se3")


def test_unknown_values_are_dashes(blind):
    assert row(printed(blind), "S-SLAM", "–")
