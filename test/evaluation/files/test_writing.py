# SPDX-License-Identifier: Apache-2.0
"""What is written is read back, by us and by `evo`."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.evaluation.files.reading import read_trajectory
from uav_vslam.evaluation.files.writing import write_csv, write_kitti, write_tum

ROUNDING_M = 1e-9  # of the written decimals
evo_files = pytest.importorskip("evo.tools.file_interface", reason="evo is a development requirement")


def test_tum_keeps_every_nanosecond_and_repeats_byte_for_byte(truth, tmp_path):
    one, two = write_tum(truth, tmp_path / "a.tum"), write_tum(truth, tmp_path / "b.tum")
    assert one.read_bytes() == two.read_bytes()
    fields = one.read_text().splitlines()[1].split()
    assert fields[0] == "1700000000.100000007"
    np.testing.assert_allclose([float(v) for v in fields[1:4]], truth.positions[1], atol=1e-9)
    np.testing.assert_allclose([float(v) for v in fields[4:]], np.roll(truth.quaternions_wxyz[1], -1), atol=1e-12)


def test_tum_pads_the_nanoseconds(truth, tmp_path):
    few = truth.select(np.arange(2))
    stamped = dataclasses.replace(few, stamps_ns=np.array([3_000_000_007, 4_050_000_000]))
    lines = write_tum(stamped, tmp_path / "padded.tum").read_text().splitlines()
    assert [line.split()[0] for line in lines] == ["3.000000007", "4.050000000"]


def test_stamps_before_zero_are_read_back(estimate, tmp_path):
    few = dataclasses.replace(estimate.select(np.arange(3)), stamps_ns=np.array([-1_500_000_000, -1, 7]))
    assert_equal(read_trajectory(write_tum(few, tmp_path / "a.tum")), few)
    assert_equal(read_trajectory(write_kitti(few, tmp_path / "a.txt")), few)


def test_evo_reads_our_tum(truth, tmp_path):
    read = evo_files.read_tum_trajectory_file(str(write_tum(truth, tmp_path / "truth.tum")))
    np.testing.assert_allclose(read.positions_xyz, truth.positions, atol=1e-9)
    np.testing.assert_allclose(read.orientations_quat_wxyz, truth.quaternions_wxyz, atol=1e-12)


def test_an_empty_track_gives_an_empty_file(truth, tmp_path):
    assert write_tum(truth.select(np.zeros(0, np.intp)), tmp_path / "none.tum").read_bytes() == b""


def assert_equal(read, written):
    np.testing.assert_array_equal(read.stamps_ns, written.stamps_ns)
    np.testing.assert_allclose(read.positions, written.positions, atol=ROUNDING_M)
    np.testing.assert_allclose(read.rotations, written.rotations, atol=1e-11)


def test_every_format_is_read_back_with_its_exact_stamps(estimate, tmp_path):
    assert_equal(read_trajectory(write_tum(estimate, tmp_path / "a.tum")), estimate)
    assert_equal(read_trajectory(write_csv(estimate, tmp_path / "a.csv")), estimate)
    kitti = write_kitti(estimate, tmp_path / "a.txt")
    assert_equal(read_trajectory(kitti, times=tmp_path / "a_times.txt"), estimate)
    assert_equal(read_trajectory(kitti), estimate)  # the stamps are beside it


def test_csv_keeps_the_covariance_and_tells_where_it_is_unknown(estimate, truth, tmp_path):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(len(estimate), 6, 6))
    estimate = dataclasses.replace(estimate, covariance=A @ A.transpose(0, 2, 1))
    read = read_trajectory(write_csv(estimate, tmp_path / "known.csv"))
    np.testing.assert_allclose(read.covariance, estimate.covariance, rtol=1e-11)
    assert read_trajectory(write_csv(truth, tmp_path / "unknown.csv")).covariance is None


def test_evo_reads_our_csv_as_euroc(estimate, tmp_path):
    read = evo_files.read_euroc_csv_trajectory(str(write_csv(estimate, tmp_path / "a.csv")))
    np.testing.assert_allclose(read.positions_xyz, estimate.positions, atol=ROUNDING_M)
    np.testing.assert_allclose(read.orientations_quat_wxyz, estimate.quaternions_wxyz, atol=1e-11)


def test_kitti_has_the_cameras_axes(truth, tmp_path):
    """Forward, left and up of ours are z, -x and -y of KITTI; evo reads the same matrices."""
    read = evo_files.read_kitti_poses_file(str(write_kitti(truth, tmp_path / "a.txt")))
    forward, left, up = truth.positions.T
    np.testing.assert_allclose(read.positions_xyz, np.stack([-left, -up, forward], axis=1), atol=ROUNDING_M)
    nose_world = truth.rotations[:, :, 0]  # x axis of the body, z axis of the camera
    nose_kitti = np.array(read.poses_se3)[:, :3, 2]
    np.testing.assert_allclose(
        nose_kitti, np.stack([-nose_world[:, 1], -nose_world[:, 2], nose_world[:, 0]], 1), atol=1e-9
    )
