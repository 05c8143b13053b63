# SPDX-License-Identifier: Apache-2.0
"""`uav-vslam mosaic` on real pictures at reduced size: all of them, where COLMAP has them, with seams that meet."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from picture_folder import flight, render, write
from PIL import Image
from similarity_errors import similarity_errors

from uav_vslam.cli.main import main

SIZE = (400, 300)
CENTRES_SHARE = 0.01  # of the flight's extent, from COLMAP's
SEAM_PX = 0.75


def rows_of(path: Path) -> list[list[str]]:
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return list(csv.reader(lines))[1:]


@pytest.mark.slow
@pytest.mark.data
def test_real_pictures_become_a_mosaic(data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, folder = data_root / "odm_caliterra", tmp_path / "pictures"
    folder.mkdir()
    for file in sorted(source.glob("*.jpg")):
        cv2.imwrite(str(folder / file.name), cv2.resize(cv2.imread(str(file)), SIZE, interpolation=cv2.INTER_AREA))
    (folder / "gps.csv").write_bytes((source / "gps.csv").read_bytes())
    assert main(["mosaic", str(folder), "--results", str(tmp_path / "results"), "--pixel", "0.4"]) == 0
    assert "GPS contradicts the pictures" in capsys.readouterr().err
    results = tmp_path / "results" / "latest"
    figures = json.loads((results / "mosaic.json").read_text())
    assert figures["used"] == 24
    assert any("GPS contradicts" in text for text in figures["warnings"])
    assert "GPS contradicts" in (results / "report.html").read_text(encoding="utf-8")
    assert figures["seam"]["median_px"] < SEAM_PX
    assert (results / "poses.csv").read_text(encoding="utf-8").startswith("picture,x_m,y_m,z_m,qw,")
    truth = {row[0]: np.array(row[1:4], float) for row in rows_of(source / "reference_poses.csv")}
    poses = {row[0]: np.array(row[1:4], float) for row in rows_of(results / "poses.csv")}
    reference = np.array([truth[name] for name in poses])
    error = similarity_errors(np.array(list(poses.values())), reference)
    assert error.max() < CENTRES_SHARE * float(np.linalg.norm(np.ptp(reference, axis=0)))
    tree = json.loads((results / "map" / "map.json").read_text())
    assert tree["orthomosaic"]["width"] == figures["width"]
    assert (results / "map" / "orthomosaic.tif").is_file()


@pytest.mark.slow
def test_without_gps_and_with_a_picture_that_can_t_be_decoded_the_results_say_so(tmp_path: Path) -> None:
    flown = flight(1, 3)
    folder = write(render(flown), flown.names(), tmp_path / "pictures")
    Image.fromarray(np.ones((48, 64), np.float32)).save(folder / "distance.tif")
    assert main(["mosaic", str(folder), "--results", str(tmp_path / "results")]) == 0
    results = tmp_path / "results" / "latest"
    assert "left out, can't be decoded: distance.tif" in json.loads((results / "mosaic.json").read_text())["warnings"]
    assert "distance.tif" in (results / "report.html").read_text(encoding="utf-8")
    assert (results / "poses.csv").read_text(encoding="utf-8").startswith("picture,x_units,y_units,z_units,qw,")


def test_a_folder_without_pictures_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "DJI_0001.MP4").write_bytes(b"video")
    assert main(["mosaic", str(tmp_path), "--results", str(tmp_path / "results")]) == 2
    said = capsys.readouterr().err
    assert "holds 0 different pictures" in said
    assert "not read: DJI_0001.MP4; convert" in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "results").exists()
