# SPDX-License-Identifier: Apache-2.0
"""Pictures pair up by their names, from wherever they come."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.calibration.pictures import FilePictures, paired, pictures_of
from uav_vslam.datasets.bag_recorder import RawRecorder
from uav_vslam.datasets.cdr import encode
from uav_vslam.datasets.message_builders import compressed_image_message, image_message
from uav_vslam.errors import CalibrationError, UavVslamError

TOPICS = ("/uav1/left/image_raw", "/uav1/right/image_raw")


def image(value: int) -> np.ndarray:
    return np.full((4, 6), value, np.uint8)


def pictures(folder: Path, *names: str) -> list[Path]:
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), image(number))
    return [folder / name for name in names]


def found(*inputs: str | Path) -> FilePictures:
    result = pictures_of([str(item) for item in inputs], most=1)
    assert isinstance(result, FilePictures)
    return result


NAMES = {
    "words": (("left01.png", "left02.png"), ("right01.png", "right02.png"), ["01", "02"]),
    "letters": (("1_L.png", "2_L.png"), ("1_R.png", "2_R.png"), ["1", "2"]),
    "cameras": (("cam0_17.png", "cam0_18.png"), ("cam1_17.png", "cam1_18.png"), ["17", "18"]),
    "stamps": (("a/900.png", "a/910.png"), ("b/900.png", "b/910.png"), ["900", "910"]),
    "nothing in common": (("p3.png", "p9.png"), ("q1.png", "q2.png"), ["001", "002"]),
}


@pytest.mark.parametrize("case", NAMES)
def test_names_pair_up_by_what_is_not_the_camera(case: str, tmp_path: Path) -> None:
    left, right, names = NAMES[case]
    lefts, rights = pictures(tmp_path, *left), pictures(tmp_path, *right)
    result = paired(lefts[::-1], rights)
    assert list(result.names) == names
    assert list(result.left) == lefts
    assert list(result.right) == rights


def test_a_picture_without_a_partner_is_named(tmp_path: Path) -> None:
    left = pictures(tmp_path, "left1.png", "left2.png", "left3.png")
    right = pictures(tmp_path, "right1.png", "right3.png", "right4.png")
    with pytest.raises(
        CalibrationError, match=r"3 left and 3 right pictures; without a partner: .*left2\.png, .*right4"
    ):
        paired(left, right)


@pytest.mark.parametrize("folders", [("left", "right"), ("cam0/data", "cam1/data"), (".", ".")])
def test_a_folder_holds_both_cameras(folders: tuple[str, str], tmp_path: Path) -> None:
    pictures(tmp_path, *(f"{folders[0]}/left{k}.png" for k in range(3)))
    pictures(tmp_path, *(f"{folders[1]}/right{k}.png" for k in range(3)))
    (tmp_path / folders[0] / "left notes.txt").write_text("not a picture")
    result = found(tmp_path)
    assert [(name, left[0, 0], right[0, 0]) for name, left, right in result] == [("0", 0, 0), ("1", 1, 1), ("2", 2, 2)]


def test_patterns_and_what_a_shell_makes_of_them_are_the_same(tmp_path: Path) -> None:
    left = pictures(tmp_path, "left1.png", "left2.png")
    right = pictures(tmp_path, "right1.png", "right2.png")
    expected = found(tmp_path / "left*", tmp_path / "right*")
    assert found(*left, *right) == expected
    assert len(expected) == 2


def test_a_shells_patterns_are_split_by_camera_and_not_by_count(tmp_path: Path) -> None:
    left = pictures(tmp_path, *(f"left{k:02}.png" for k in range(3)))
    right = pictures(tmp_path, *(f"right{k:02}.png" for k in range(5)))
    with pytest.raises(
        CalibrationError, match=r"3 left and 5 right pictures; without a partner: .*right03\.png, .*right04"
    ):
        found(*left, *right)
    with pytest.raises(CalibrationError, match=r"without a partner: .*left02\.png;"):
        found(*left, *right[:2])
    assert found(*left, *right[:3]) == paired(left, right[:3])


@pytest.mark.parametrize("name", ["{}.png", "cam_{}.png", "left_{}.png"])
def test_a_shells_patterns_are_split_by_folder_where_names_do_not_tell_the_camera(name: str, tmp_path: Path) -> None:
    names = [name.format(k) for k in range(12)]
    left, right = (pictures(tmp_path / side, *names) for side in ("b", "a"))
    result = found(*left, *right)
    assert [path.name for path in result.left] == [path.name for path in result.right]
    assert {path.parent.name for path in result.left} == {"b"}
    assert len(result) == 12


SWAPPED = {
    "words": ("left{}.png", "right{}.png"),
    "letters": ("{}_L.png", "{}_R.png"),
    "cameras": ("cam0_{}.png", "cam1_{}.png"),
    "folders": ("left/{}.png", "right/{}.png"),
    "folders of cameras": ("cam0/data/{}.png", "cam1/data/{}.png"),
    "both": ("cam0/left{}.png", "cam1/right{}.png"),
}


@pytest.mark.parametrize("case", SWAPPED)
def test_a_shells_patterns_may_name_the_right_camera_first(case: str, tmp_path: Path) -> None:
    left, right = (pictures(tmp_path, *(name.format(k) for k in range(10, 14))) for name in SWAPPED[case])
    assert found(*right, *left) == found(*left, *right)
    assert list(found(*right, *left).left) == left


def test_names_that_tell_the_cameras_but_no_sides_leave_the_order(tmp_path: Path) -> None:
    left, right = (pictures(tmp_path, *(f"{name}{k}.png" for k in range(10, 14))) for name in ("right", "cam0_"))
    assert list(found(*left, *right).left) == left


def test_pictures_that_could_be_of_one_pair_are_refused(tmp_path: Path) -> None:
    left, right = (pictures(tmp_path, f"day1/{side}1.png", f"day2/{side}1.png") for side in ("left", "right"))
    with pytest.raises(CalibrationError, match=r"day1/left1\.png and .*day2/left1\.png could both be of pair '1'"):
        found(*left, *right)


def test_pictures_whose_camera_nothing_tells_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="neither names nor folders identify the two cameras of 4 pictures"):
        found(*pictures(tmp_path, "p1.png", "p2.png", "q1.png", "q2.png"))


def recorded(path: Path, *topics: str) -> str:
    """Return a bag of twelve pairs, the right images 2 ms later."""
    with RawRecorder(path) as recorder:
        for k in range(12):
            for side, topic in enumerate(topics):
                stamp_ns = k * 100_000_000 + side % 2 * 2_000_000
                if topic.endswith("/compressed"):
                    png = cv2.imencode(".png", image(k))[1].tobytes()
                    built = compressed_image_message(stamp_ns, "", png, fmt="png")
                else:
                    built = image_message(stamp_ns, "", image(k))
                recorder.write(topic, built.__msgtype__, encode(built), stamp_ns)
    return str(path)


@pytest.mark.parametrize("kind", ["", "/compressed"])
@pytest.mark.parametrize("given", [None, TOPICS])
def test_images_of_a_recording_are_paired_and_thinned(given: tuple[str, str] | None, kind: str, tmp_path: Path) -> None:
    result = pictures_of([recorded(tmp_path / "bag", *(name + kind for name in TOPICS))], topics=given, most=5)
    read = [(name, int(left[0, 0]), int(right[0, 0])) for name, left, right in result]
    assert read == [(f"{0.3 * k:.3f}", 3 * k, 3 * k) for k in range(4)]
    assert len(result) == 4


def test_a_recording_without_metadata_is_one(tmp_path: Path) -> None:
    bag = Path(recorded(tmp_path / "bag", *TOPICS))
    (bag / "metadata.yaml").unlink()
    assert len(pictures_of([str(bag)], most=5)) == 4


def test_pictures_that_can_not_be_read_come_as_the_reason(tmp_path: Path) -> None:
    left, right = (pictures(tmp_path, *(f"{side}{k}.png" for k in range(3))) for side in ("left", "right"))
    right[1].write_bytes(b"no picture")
    read = list(paired(left, right))
    assert [name for name, *both in read if not any(isinstance(one, UavVslamError) for one in both)] == ["0", "2"]
    assert str(read[1][2]) == f"{right[1]} can't be read as an image"


def test_images_of_a_recording_that_can_not_be_read_come_as_the_reason(tmp_path: Path) -> None:
    bag, numbers = tmp_path / "bag", iter(range(12))
    with RawRecorder(bag) as recorder:
        for k in range(4):
            for topic in TOPICS:
                built = image_message(k * 100_000_000, "", image(k))
                data = {2: encode(built)[:40], 5: b"\0\1\0\0"}.get(next(numbers), encode(built))
                recorder.write(topic, built.__msgtype__, data, k * 100_000_000)
    read = [(name, *map(str, both)) for name, *both in pictures_of([str(bag)], topics=TOPICS, most=99)]
    assert [name for name, *_ in read] == ["0.000", "0.100", "0.200", "0.300"]
    assert "not a valid sensor_msgs/msg/Image" in read[1][1]
    assert read[2][1:] == ("a message of 4 bytes has no header; record the topic again",) * 2


def test_a_recording_of_other_topics_or_several_vehicles_is_told_with_its_topics(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "bag", *TOPICS, "/uav2/left/image_raw", "/uav2/right/image_raw")
    with pytest.raises(CalibrationError, match=r"has no /a/left; name the images by --topics; it has /uav1/left"):
        pictures_of([bag], topics=("/a/left", TOPICS[1]), most=99)
    with pytest.raises(CalibrationError, match="has several vehicles; name the images by --topics; it has /uav1/left"):
        pictures_of([bag], most=99)
    assert len(pictures_of([bag], topics=("/uav2/left/image_raw", "/uav2/right/image_raw"), most=99)) == 12


def test_what_holds_no_pictures_is_told(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="holds 0 pictures named left and 0 named right"):
        found(tmp_path)
    with pytest.raises(CalibrationError, match=r"no picture is like .*left\*"):
        found(tmp_path / "left*", tmp_path / "right*")
    (tmp_path / "notes.txt").touch()
    for name in ("nowhere", "notes.txt"):
        with pytest.raises(CalibrationError, match=f"{name} is neither a folder of pictures nor a bag; give one"):
            found(tmp_path / name)


def test_one_camera_named_as_both_is_refused(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "bag", *TOPICS)
    with pytest.raises(CalibrationError, match=f"{TOPICS[0]} is named as left and as right"):
        pictures_of([bag], topics=(TOPICS[0], TOPICS[0]), most=99)
    for name in ("left1.png", "left2.png"):
        (tmp_path / name).touch()
    with pytest.raises(CalibrationError, match=r"left1\.png is named as left and as right"):
        pictures_of([f"{tmp_path}/left*.png", f"{tmp_path}/left*.png"], most=99)


def test_a_topic_without_images_is_refused() -> None:
    sample = str(Path(__file__).parents[2] / "bags" / "sample")
    with pytest.raises(CalibrationError, match=r"/uav1/imu/data_raw is of sensor_msgs/msg/Imu, no images"):
        pictures_of([sample], topics=("/uav1/left/image_raw", "/uav1/imu/data_raw"), most=99)
