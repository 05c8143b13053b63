# SPDX-License-Identifier: Apache-2.0
"""Formats are told by their content; wrong files are refused with file and line."""

import numpy as np
import pytest

from uav_vslam.errors import TrajectoryFileError
from uav_vslam.evaluation.files.reading import read_trajectory

POSE = "1 2 3 0 0 0 1"
TUM = f"# timestamp x y z qx qy qz qw\n10.000000007 {POSE}\n10.5 {POSE}\n"
KITTI = "1 0 0 5 0 1 0 -2 0 0 1 7\n0 0 1 6 0 1 0 -3 -1 0 0 8\n"
EUROC = (
    "#timestamp,px,py,pz,qw,qx,qy,qz,vx\n1403715273262142976,1,2,3,0.6,0.8,0,0,9\n1403715273312143104,1,2,4,1,0,0,0,9\n"
)


@pytest.fixture
def file(tmp_path):
    """Return a maker of files."""

    def make(text, name="poses.txt"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


def test_tum_has_seconds_and_the_real_part_last(file):
    read = read_trajectory(file(TUM))
    assert read.stamps_ns.tolist() == [10_000_000_007, 10_500_000_000]
    assert read.positions.tolist() == [[1.0, 2.0, 3.0]] * 2
    assert read.quaternions_wxyz.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 2


def test_commas_of_an_indented_comment_separate_no_columns(file):
    assert len(read_trajectory(file(f"  # from the lab, second flight\n{TUM}"))) == 2


def test_euroc_has_nanoseconds_and_the_real_part_first(file):
    read = read_trajectory(file(EUROC))
    assert read.stamps_ns.tolist() == [1403715273262142976, 1403715273312143104]
    np.testing.assert_allclose(read.quaternions_wxyz, [[0.6, 0.8, 0, 0], [1, 0, 0, 0]])
    assert read.covariance is None


def test_a_title_that_names_xyzw_is_honoured_as_are_seconds(file):
    read = read_trajectory(file("t [s],x,y,z,q_x [-],q_y,q_z,q_w\n10.5,1,2,3,0.8,0,0,0.6\n"))
    assert read.stamps_ns.tolist() == [10_500_000_000]
    np.testing.assert_allclose(read.quaternions_wxyz, [[0.6, 0.8, 0, 0]])


@pytest.mark.parametrize(
    ("title", "quaternion"),
    [
        ("# timestamp x y z qw qx qy qz", [0.6, 0.8, 0, 0]),
        ("# timestamp x y z qx qy qz qw", [0, 0.6, 0.8, 0]),
        ("# a comment of eight words is no title", [0, 0.6, 0.8, 0]),
    ],
)
def test_the_title_of_a_tum_file_tells_the_order_of_the_quaternion(file, title, quaternion):
    read = read_trajectory(file(f"{title}\n10.5 1 2 3 0.6 0.8 0 0\n"))
    np.testing.assert_allclose(read.quaternions_wxyz, [quaternion])


def test_seconds_are_seconds_where_the_first_stamp_is_a_plain_zero(file):
    read = read_trajectory(file("t,x,y,z,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n0.140056,1,2,3,1,0,0,0\n"))
    assert read.stamps_ns.tolist() == [0, 140_056_000]


def test_kitti_is_turned_to_forward_left_up(file):
    read = read_trajectory(file(KITTI), times=file("0.0\n1.036224e-01\n", "times.txt"))
    assert read.stamps_ns.tolist() == [0, 103_622_400]
    assert read.positions.tolist() == [[7.0, -5.0, 2.0], [8.0, -6.0, 3.0]]
    # about KITTI's y axis, downward, by +90 degrees: a turn to the right, about our z by -90 degrees
    np.testing.assert_allclose(read.rotations[1], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_kitti_takes_the_stamps_of_a_reference_with_as_many_poses(file):
    reference = read_trajectory(file(TUM, "reference.txt"))
    assert read_trajectory(file(KITTI), reference=reference).stamps_ns.tolist() == reference.stamps_ns.tolist()
    assert np.diff(read_trajectory(file(KITTI), numbered=True).stamps_ns).tolist() == [100_000_000]


def test_nanoseconds_since_1970_are_recognised_in_tum(file):
    """As ORB-SLAM3 writes them for EuRoC, with a fraction."""
    read = read_trajectory(file(f"1403715273262142976.000000 {POSE}\n1.403715273312143104e+18 {POSE}\n"))
    assert read.stamps_ns.tolist() == [1403715273262142976, 1403715273312143104]


WRONG = {
    "empty": ("", "poses.txt holds no poses"),
    "only a comment": ("# timestamp x y z\n", "poses.txt holds no poses"),
    "a picture": (b"\x89PNG\xff\x00", "not a text file"),
    "too few columns": ("1 2 3 4\n", r"poses.txt:1: 4 columns are no pose.*TUM.*KITTI.*EuRoC"),
    "a short line": (f"1 {POSE}\n2 1 2 3\n", r"poses.txt:2: 4 columns, but line 1 has 8"),
    "NaN": (f"1 {POSE}\n\n2 1 nan 3 0 0 0 1\n", r"poses.txt:3: column 3 holds 'nan', not a finite number"),
    "NaN in front": (f"nan {POSE}\n", r"poses.txt:1: the stamp 'nan' is not a number"),
    "beyond all sizes": (f"1e999999999999 {POSE}\n", r"poses.txt:1: the stamp '1e999999999999' is not a number"),
    "infinity": (f"1 {POSE}\n2 1 inf 3 0 0 0 1\n", r"poses.txt:2: column 3 holds 'inf'"),
    "a word": (f"1 {POSE}\n2 1 lost 3 0 0 0 1\n", r"poses.txt:2: column 3 holds 'lost'"),
    "unsorted": (f"1 {POSE}\n3 {POSE}\n# odd\n2 {POSE}\n", r"poses.txt:4: the stamp 2 is not after 3 of line 2; sort"),
    "repeated": (f"1 {POSE}\n1.0 {POSE}\n", r"poses.txt:2: the stamp 1.0 is not after 1 of line 1"),
    "microseconds": (
        f"1403715273262142 {POSE}\n",
        r"poses.txt:1: the stamp 1403715273262142 is neither in seconds nor",
    ),
    "no quaternion": ("1 1 2 3 0 0 0 0\n", r"poses.txt:1: the quaternion in columns 5 to 8 has length 0, expected 1"),
    "Euler angles": ("#t,x,y,z,roll,pitch,yaw,v\n1,1,2,3,0,0,0,1\n", "column 5 is called 'roll'; expected q_w"),
    "no rotation": ("2 0 0 5 0 1 0 -2 0 0 1 7\n", r"poses.txt:1: .*are not a rotation"),
    "mirrored": ("-1 0 0 5 0 1 0 -2 0 0 1 7\n", r"poses.txt:1: .*are not a rotation"),
    "part of a covariance": (
        "#t,x,y,z,qw,qx,qy,qz,cov_x_x\n1,1,2,3,1,0,0,0,4\n",
        "1 columns of covariance, expected 21",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_with_its_line(case, file):
    text, expected = WRONG[case]
    with pytest.raises(TrajectoryFileError, match=expected):
        read_trajectory(file(text), numbered=True)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrajectoryFileError, match=r"nowhere.txt can't be read: No such file"):
        read_trajectory(tmp_path / "nowhere.txt")


def test_kitti_without_stamps_says_what_is_missing(file):
    with pytest.raises(TrajectoryFileError, match=r"KITTI file, which has no stamps; give --times"):
        read_trajectory(file(KITTI))
    three = read_trajectory(file(TUM + f"11 {POSE}\n", "three.txt"))
    with pytest.raises(TrajectoryFileError, match=r"its 2 poses are not the 3 of the ground truth; give --times"):
        read_trajectory(file(KITTI), reference=three)
    with pytest.raises(TrajectoryFileError, match=r"times.txt: 3 lines of 1 columns, but .* has 2 poses"):
        read_trajectory(file(KITTI), times=file("0\n1\n2\n", "times.txt"))


@pytest.mark.data
def test_the_truth_of_a_real_sequence_is_read(data_root):
    path = data_root / "euroc_v101_keyframes/mav0/state_groundtruth_estimate0/data.csv"
    read = read_trajectory(path)
    first = path.read_text().splitlines()[1].split(",")
    assert read.stamps_ns[0] == int(first[0])
    np.testing.assert_allclose(read.positions[0], [float(cell) for cell in first[1:4]])
    np.testing.assert_allclose(read.quaternions_wxyz[0], [float(cell) for cell in first[4:8]], atol=1e-4)
    assert 55.0 < read.path_length_m < 60.0
