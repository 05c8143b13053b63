# SPDX-License-Identifier: Apache-2.0
"""What an import can't use is refused before it starts, with the remedy."""

from pathlib import Path

import pytest

from uav_vslam.cli.main import main


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--vehicle", "1 bad"], "'1 bad' is no ROS namespace"),
        (["--initial-sigma", "0", "0", "0", "0", "0"], "'0' is not a number above 0"),
        (["--initial-sigma", "1e-300", "1", "1", "1", "1"], "'1e-300' is not a number above 0, of a size from 1e-12"),
    ],
)
def test_a_wrong_value_is_refused(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["import", "euroc", str(tmp_path), str(tmp_path / "out"), *options])
    assert refused.value.code == 2
    assert message in capsys.readouterr().err


def test_a_folder_that_is_none_of_a_sequence_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "euroc", str(tmp_path), str(tmp_path / "out")]) == 2
    assert "has no folder cam0; give the sequence's mav0 folder" in capsys.readouterr().err


@pytest.mark.parametrize("verb", [["import", "euroc", "."], ["simulate"]])
def test_compression_that_the_storage_lacks_is_refused(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*verb, str(tmp_path / "out"), "--zstd", "--storage", "sqlite3"]) == 2
    assert "--zstd compresses mcap files" in capsys.readouterr().err


def test_a_raw_drive_of_kitti_is_no_sequence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "drive" / "image_00" / "data").mkdir(parents=True)
    assert main(["import", "kitti", str(tmp_path / "drive"), str(tmp_path / "out")]) == 2
    assert (
        "drive is a raw drive; give the sequence that was made of it, sequences/NN of the odometry benchmark"
        in capsys.readouterr().err
    )
    assert main(["run", str(tmp_path / "drive")]) == 2
    assert "import it: uav-vslam import --help" in capsys.readouterr().err


def test_a_data_set_in_place_of_a_bag_is_pointed_to_the_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mav0").mkdir()
    assert main(["run", str(tmp_path)]) == 2
    assert "import it: uav-vslam import --help" in capsys.readouterr().err
