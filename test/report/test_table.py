# SPDX-License-Identifier: Apache-2.0
import dataclasses
import io

from rich.console import Console

from uav_vslam.evaluation.result import LinkCounters
from uav_vslam.evaluation.summary import build_summary
from uav_vslam.report.table import link_line, print_summary
from uav_vslam.types import FrameQuality


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
    for titles in (("ATE [m]", "NEES"), ("unaligned", "start yaw", "SE3"), ("14 m", "100 m"), ("[mrad]",)):
        assert row(text, *titles)
    assert text.count("C-SLAM") == 6  # two tables
    assert "test flight, mode wideband, seed 5, 9.9 s of flight, 3.00x real time" in text


def test_a_single_vehicle_has_neither_peer_nor_pool(single):
    text = printed(single)
    assert "pooled" not in text
    assert "C-SLAM" not in text
    assert "uav1: 198 m, 100 of 101 frames; no peer" in text


def test_a_vehicle_that_fuses_a_map_alone_has_no_peer(pair):
    alone = dataclasses.replace(pair.vehicles["uav1"], link=LinkCounters())
    text = printed(dataclasses.replace(pair, mode="none", vehicles={"uav1": alone}))
    assert "C-SLAM" in text
    assert "uav1: 198 m, 100 of 101 frames; no peer" in text


def test_the_link_line_shows_rates_and_drops(pair):
    line = link_line("uav2", build_summary(pair, git=None)["vehicles"]["uav2"], "wideband")
    assert line == ("uav2: 198 m, 100 of 101 frames; sent 10 packets, 18.23 kB/s; received 9, used 8; dropped: 1 stale")


def test_an_alignment_is_named(pair):
    assert "aligned (se3)" in printed(pair, alignment="se3")


def test_unknown_values_are_dashes(blind):
    vehicle = blind.vehicles["uav1"]
    bare = dataclasses.replace(vehicle, s_slam=dataclasses.replace(vehicle.s_slam, covariance=None))
    assert row(printed(dataclasses.replace(blind, vehicles={"uav1": bare})), "S-SLAM", "–")


def frame(k, **changes):
    """Return a good frame of 100 degrees of freedom, 0.1 s apart."""
    good = FrameQuality(10**18 + 100_000_000 * k, 90, 80, 25, 0, 60, False, False, False, 0, 100.0, 100, 1.0)
    return dataclasses.replace(good, **changes)


def judged(flight, frames, **changes):
    """Return what is printed of a vehicle with such frames."""
    vehicles = {
        name: dataclasses.replace(vehicle, frames=tuple(frames), **changes) for name, vehicle in flight.vehicles.items()
    }
    return printed(dataclasses.replace(flight, vehicles=vehicles))


def test_without_truth_the_table_shows_what_the_estimate_claims(blind):
    text = printed(blind)
    assert row(text, "1σ at", "per 100 m", "heading")
    assert row(text, "S-SLAM", "0.866", "0.437", "28.6")  # 0.5 m an axis after 198 m, 0.5 rad
    assert "ATE" not in text
    assert "NEES" not in text


def test_a_run_without_truth_is_judged_in_sentences(blind):
    frames = [frame(k, coasted=k in (5, 6, 50), dof=100 * (k not in (5, 6, 50))) for k in range(100)]
    frames[20] = frame(20, restarted=True, relocalised=True, closures=7, nis=300.0)
    text = judged(blind, frames, alarms={1: ("left camera",), 2: ("left camera",)}, dropped={"unpaired": 2})
    assert row(text, "innovations consistent: NIS/dof 1.02 in [0.97, 1.03]; 1 % of frames outside")
    assert row(text, "median 90 features, 80 tracked, 25 associated; coasted 3 of 100 frames (longest 2, 0.3 s)")
    assert row(text, "S-SLAM claims 1 sigma of 0.866 m after 198 m (0.437 m/100 m), heading 28.6 deg")
    assert row(text, "closures 7, re-initialisations 1, relocalisations 1, alarm left camera 2, dropped unpaired 2")


def test_the_calibration_is_printed_as_last_estimated(pair):
    """The last frame has no estimate of the clocks."""
    frames = [frame(k, time_offset_s=-1e-3 * k, time_offset_sigma_s=1e-4 * (k < 2)) for k in range(3)]
    assert row(judged(pair, frames), "calibration estimated: exposure -1.00 ± 0.10 ms from the stamp")
    frames = [frame(0, disparity_error_px=0.25, disparity_error_sigma_px=0.01)]
    assert row(judged(pair, frames), "calibration estimated: disparity off by +0.250 ± 0.010 px")
    assert "calibration" not in judged(pair, [frame(0)])


def test_the_verdict_names_side_and_size(pair):
    assert row(judged(pair, [frame(k, nis=400.0) for k in range(9)]), "over-confident", "above", "2 x claimed")
    assert row(judged(pair, [frame(k, nis=25.0) for k in range(9)]), "conservative", "below", "0.5 x claimed")
    assert row(judged(pair, [frame(0, nis=0.0, dof=0)]), "no visual update")


def test_no_line_is_wider_than_a_hundred_columns(pair):
    text = judged(pair, [frame(k, nis=40000.0, coasted=k % 2 == 0) for k in range(2000)], dropped={"unpaired": 1234})
    assert max(map(len, text.splitlines())) <= 100
