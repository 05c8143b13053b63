# SPDX-License-Identifier: Apache-2.0
"""Tables of traffic, time and landmarks hold what was recorded, and are read back."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from made_up_results import COVARIANCE, FLIGHT, LANDMARKS, VEHICLES, landmarks, write_bare, write_full

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.evaluation.files.tables import Columns, read_columns
from uav_vslam.evaluation.flight_tables import write_landmarks, write_link, write_timing
from uav_vslam.evaluation.output import write_results
from uav_vslam.types import NS_PER_S, LinkEpoch

START_NS = 1_700_000_000_000_000_007  # not a whole second: a float would lose the last digits


def test_traffic_keeps_its_stamps_and_counts(tmp_path: Path) -> None:
    epochs = [LinkEpoch(START_NS + 10**9 * k, k, 100 * k, 2 * k, 300 * k, k) for k in range(3)]
    table = read_columns(write_link(epochs, tmp_path / "link.csv", start_ns=START_NS))
    assert [int(cell) for cell in table["stamp_ns"]] == [epoch.stamp_ns for epoch in epochs]
    assert table["time_s"] == ["0.000000", "1.000000", "2.000000"]
    assert table["bytes_received"] == ["0", "300", "600"]


def test_a_stage_that_did_not_run_has_no_time(tmp_path: Path) -> None:
    path = write_timing(
        {"frontend": {START_NS: 0.01, START_NS + 5: 0.02}, "fusion": {START_NS + 5: 0.5}},
        tmp_path / "t",
        start_ns=START_NS,
    )
    table = read_columns(path)
    np.testing.assert_array_equal(table.numbers("frontend_ms"), [10.0, 20.0])
    np.testing.assert_array_equal(table.numbers("fusion_ms"), [np.nan, 500.0])


def test_landmarks_keep_place_and_covariance(tmp_path: Path) -> None:
    path = write_landmarks(landmarks(0.0), tmp_path / "landmarks.csv")
    table = read_columns(path)
    assert len(table["id"]) == LANDMARKS
    np.testing.assert_allclose(table.numbers("x_m"), landmarks(0.0).positions[:, 0], atol=1e-4)
    cells = [table.numbers(f"cov_{pair}") for pair in ("x_x", "x_y", "x_z", "y_y", "y_z", "z_z")]
    np.testing.assert_allclose(np.array(cells).T, np.tile(COVARIANCE[np.triu_indices(3)], (LANDMARKS, 1)), rtol=1e-4)


def test_a_flight_leaves_the_tables_that_it_has_records_for(tmp_path: Path) -> None:
    tables = {"uav1_link.csv", "uav1_timing.csv", "uav1_landmarks.csv", "uav1_frames.csv"}
    assert tables <= {path.name for path in write_full(tmp_path).iterdir()}
    assert not tables & {path.name for path in write_bare(tmp_path).iterdir()}


def test_all_tables_of_a_flight_count_time_from_its_first_frame(tmp_path: Path) -> None:
    """The first epoch is a second later, and images are processed before there is a start."""
    whole = VEHICLES["uav1"]
    assert whole.frames is not None
    cut = dataclasses.replace(whole, frames=whole.frames[5:], epochs=whole.epochs[1:])
    folder = write_results(dataclasses.replace(FLIGHT, vehicles={"uav1": cut}), tmp_path)
    frames, link, timing = (read_columns(folder / f"uav1_{name}.csv") for name in ("frames", "link", "timing"))
    for table in (frames, link, timing):
        since_ns = [int(stamp) - whole.frames[5].stamp_ns for stamp in table["stamp_ns"]]
        np.testing.assert_allclose([float(cell) for cell in table["time_s"]], np.array(since_ns) / NS_PER_S, atol=1e-6)
    assert float(timing["time_s"][0]) < 0.0 < float(link["time_s"][0])


def test_damaged_tables_are_named(tmp_path: Path) -> None:
    path = tmp_path / "link.csv"
    path.write_text("a,b\n1,2\n3\n")
    with pytest.raises(TrajectoryFileError, match=r"link\.csv:3: 1 cells, but the title has 2"):
        read_columns(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TrajectoryFileError, match=r"link\.csv is no table .*restore or remove"):
        read_columns(path)
    with pytest.raises(TrajectoryFileError, match="could not convert"):
        Columns({"a": ["1", "x"]}, path).numbers("a")
