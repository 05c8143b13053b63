# SPDX-License-Identifier: Apache-2.0
"""`study split` flies the legs as the bag of `uav-vslam cut` is flown, and scores them by the truth."""

import dataclasses
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.cli.main import main
from uav_vslam.config import VehicleConfig, find_config, load_fleet, load_vehicle
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.cut_options import CutOptions
from uav_vslam.datasets.cut_writer import FLEET_FILE, write_cut
from uav_vslam.datasets.cutting import Cut, plan_cut, poses_of, with_drawn_starts
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.offline.flight import fly
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.studies.split.compute import C_SLAM, INS, METHODS, S_SLAM, Outcome, run_starts, searched_legs
from uav_vslam.studies.split.rows import error_rows, failure_note, series_of

pytestmark = pytest.mark.slow

LEGS = CutOptions(legs_s=((0.0, 1.5), (1.6, 3.2)))
CONFIG = load_vehicle(find_config("kagaru"), overrides={"fusion.epoch_s": 0.3})  # several packets in a leg


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "flight"
    record(Scenario(frames=24, vehicles=1, scale=0.25, seed=6), path)
    return path


@pytest.fixture(scope="module")
def flight(bag: Path) -> BagFlight:
    return open_flight(bag, "uav1")


@pytest.fixture(scope="module")
def cut(flight: BagFlight) -> Cut:
    return plan_cut(flight, *poses_of(flight), CONFIG, LEGS)


@pytest.fixture(scope="module")
def legs(flight: BagFlight, cut: Cut) -> list[RecordedFlight]:
    return searched_legs(flight, cut, poses_of(flight)[0], CONFIG)


@pytest.fixture(scope="module")
def outcomes(legs: list[RecordedFlight], cut: Cut) -> list[Outcome]:
    return run_starts(legs, cut, CONFIG, [1, 2, 3])


def test_a_leg_flies_as_the_bag_of_the_cut(
    flight: BagFlight, cut: Cut, outcomes: list[Outcome], tmp_path: Path
) -> None:
    write_cut(tmp_path / "pair", flight, with_drawn_starts(cut, 1).vehicles, CONFIG)
    fleet = load_fleet(tmp_path / "pair" / FLEET_FILE)
    tracks, members = fly([open_flight(fleet.replay.bags, name) for name in fleet.vehicles], fleet.vehicles)
    for name, track in tracks.items():
        own = Trajectory.from_estimates(track.poses)
        fused = Trajectory.from_estimates(members[name].poses)
        for label, expected in ((S_SLAM, own), (C_SLAM["wideband"], fused)):
            found = outcomes[0].tracks[label][name]
            np.testing.assert_array_equal(found.stamps_ns, expected.stamps_ns)
            # The bag's quaternion rounds the start, and the window solves rounding of any size up to some 1e-8 m.
            np.testing.assert_allclose(found.positions, expected.positions, rtol=0.0, atol=1e-6)


def test_all_legs_start_at_once(legs: list[RecordedFlight]) -> None:
    assert legs[0].frame_stamps_ns[0] == legs[1].frame_stamps_ns[0]


def test_the_rows_are_the_errors_against_the_truth(legs: list[RecordedFlight], outcomes: list[Outcome]) -> None:
    """The truth moved 0.3, 0.4 and 1.2 m aside is 1.3 m off everywhere, 1.2 m of it in height."""
    aside = {}
    for label in METHODS:
        tracks = outcomes[0].tracks[label]
        at = {leg.vehicle: np.isin(leg.truth.stamps_ns, tracks[leg.vehicle].stamps_ns) for leg in legs}
        shift = np.array([0.3, 0.4, 1.2]) * (0.5 if label in C_SLAM.values() else 1.0)
        aside[label] = {
            leg.vehicle: dataclasses.replace(
                leg.truth.select(at[leg.vehicle]),
                positions=leg.truth.positions[at[leg.vehicle]] + shift,
                covariance=np.tile(np.eye(6), (int(at[leg.vehicle].sum()), 1, 1)),
            )
            for leg in legs
        }
    used = {label: {"uav1": 2, "uav2": 3} for label in C_SLAM.values()}
    rows = error_rows(legs, [Outcome(seed, aside, used) for seed in (1, 2, 3)])
    assert [row["condition"] for row in rows] == ["uav1"] * 4 + ["uav2"] * 4 + ["both"] * 4
    assert [row["method"] for row in rows[:4]] == list(METHODS)
    for row in rows:
        fused = row["method"] in C_SLAM.values()
        scale = 0.5 if fused else 1.0
        found = [row[key] for key in ("end_rms_m", "ate_rms_m", "height_rms_m")]
        np.testing.assert_allclose(found, [1.3 * scale, 1.3 * scale, 1.2 * scale])
        expected = [0.5, 0.5, 0.5] if fused else [None] * 3
        assert [row[key] for key in ("ratio_to_s_slam", "ratio_low", "ratio_high")] == pytest.approx(expected)
    assert [row["packets_used"] for row in rows[-2:]] == [15, 15]


@pytest.mark.parametrize("lost", [slice(0, 3), slice(4, 6), slice(8, None)])
def test_errors_are_averaged_at_equal_stamps(legs: list[RecordedFlight], outcomes: list[Outcome], lost: slice) -> None:
    """A track of one seed, whichever, lacks some poses: the curves of all seeds are those without these."""
    full = series_of(legs, outcomes)
    kept = np.delete(np.arange(len(outcomes[0].tracks[S_SLAM]["uav1"])), lost)
    for seed in range(3):
        changed = list(outcomes)
        short = outcomes[seed].tracks[S_SLAM]["uav1"].select(kept)
        tracks = outcomes[seed].tracks | {S_SLAM: {**outcomes[seed].tracks[S_SLAM], "uav1": short}}
        changed[seed] = dataclasses.replace(outcomes[seed], tracks=tracks)
        for curve, whole in zip(series_of(legs, changed), full, strict=True):
            rows = kept if (curve["method"], curve["condition"]) == (S_SLAM, "uav1") else slice(None)
            for key in ("time_s", "east_m", "error_up_rms_m"):
                np.testing.assert_allclose(curve[key], np.array(whole[key])[rows])


def test_a_failed_run_is_counted_and_explained(legs: list[RecordedFlight], outcomes: list[Outcome]) -> None:
    with_failure = [*outcomes, Outcome(4, failure="the filter diverged")]
    rows = error_rows(legs, with_failure)
    assert {(row["failures"], row["runs"]) for row in rows} == {(1, 4)}
    assert [row["ate_rms_m"] for row in rows] == [row["ate_rms_m"] for row in error_rows(legs, outcomes)]
    assert failure_note(with_failure) == {"Failures": "seed 4: the filter diverged"}
    assert failure_note(outcomes) == {}


def test_slam_is_better_than_the_ins(legs: list[RecordedFlight], outcomes: list[Outcome]) -> None:
    both = {row["method"]: row["end_rms_m"] for row in error_rows(legs, outcomes) if row["condition"] == "both"}
    assert both[S_SLAM] < both[INS]


def test_a_run_that_diverges_everywhere_still_has_a_table(legs: list[RecordedFlight]) -> None:
    rows = error_rows(legs, [Outcome(1, failure="the filter diverged")])
    assert all(row["ate_rms_m"] is None for row in rows)


def test_the_study_leaves_its_table_and_picture(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--config", "kagaru", "--legs", "0-1.5,1.6-3.2", "--seeds", "2", "--workers", "1"]
    assert main(["study", "split", str(bag), *arguments, "--results", str(tmp_path)]) == 0
    tree = json.loads((tmp_path / "latest" / "study.json").read_text())
    assert list(dict.fromkeys(row["table"] for row in tree["rows"])) == ["Legs", "Overlap", "Errors"]
    assert re.search(r"\| C-SLAM wideband +\| both +\|", capsys.readouterr().out)
    assert cv2.imread(str(tmp_path / "latest" / "split.png")).std() > 5


def test_options_that_would_have_no_effect_are_refused(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "split", str(bag), "--legs", "0-1.5,1.6-3.2", "--vehicles", "3"]) == 2
    assert "leave out --vehicles" in capsys.readouterr().err


def test_a_setting_reaches_the_runs(legs: list[RecordedFlight], cut: Cut, outcomes: list[Outcome]) -> None:
    config: VehicleConfig = dataclasses.replace(CONFIG, fusion=dataclasses.replace(CONFIG.fusion, min_common=60))
    alone = run_starts(legs, cut, config, [1])[0]
    assert sum(alone.packets_used[C_SLAM["wideband"]].values()) == 0
    assert sum(outcomes[0].packets_used[C_SLAM["wideband"]].values()) > 0
