# SPDX-License-Identifier: Apache-2.0
"""`map` flies and maps, or maps a flight that has been run: the same map."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from geotiff import place
from rendered_views import pose, view

from uav_vslam.cli.main import main
from uav_vslam.cli.map import doubts, write_map
from uav_vslam.cli.map_picture import default_pixel_m
from uav_vslam.datasets.flight_writer import ImageCoding
from uav_vslam.evaluation.files.geodetic import Datum, to_geodetic
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.mapping.raster import Raster
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import SurfaceMapper
from uav_vslam.mapping.surface.settings import SurfaceSettings
from uav_vslam.simulation.recording import record
from uav_vslam.simulation.scenario import SCENARIOS
from uav_vslam.simulation.terrain import ground_of

pytestmark = pytest.mark.slow

SCENARIO = dataclasses.replace(SCENARIOS["sample"], frames=7, vehicles=2)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "bag"
    record(SCENARIO, path, coding=ImageCoding("png"))
    return path


@pytest.fixture(scope="module")
def result(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("results")
    options = ["--no-plots", "--workers", "1", "--cell", "1"]
    assert main(["map", str(bag), "--config", "sample", *options, "--results", str(root)]) == 0
    return (root / "latest").resolve()


def test_a_map_of_two_vehicles_lies_on_the_true_ground(result: Path) -> None:
    tree = json.loads((result / "map/map.json").read_text())
    assert {name: vehicle["views"] for name, vehicle in tree["vehicles"].items()} == {"uav1": 7, "uav2": 7}
    assert sum(vehicle["share"] for vehicle in tree["vehicles"].values()) == pytest.approx(1.0)
    assert (tree["frame"], tree["north_up"]) == ("world", True)
    assert tree["surface"]["coverage"] > 0.8
    assert tree["gsd_m"] == pytest.approx(70.0 / (1642.0 * 0.375), rel=0.05)
    grid = HeightGrid.open(result / "map/tiles")
    west, south, east, north = tree["bounds_m"]
    raster = Raster(1.0, round(west), round(south), round(east - west), round(north - south))
    truth = ground_of(SCENARIO).height(*np.meshgrid(raster.x, raster.y))
    assert np.nanmedian(np.abs(grid.height(raster) - truth)) < 0.3
    assert {"height.png", "overlap.png"} <= {path.name for path in (result / "map").iterdir()}
    assert not (result / "report.html").exists()


def test_the_orthomosaic_of_two_vehicles_shows_the_true_ground_at_its_place(result: Path) -> None:
    picture = cv2.imread(str(result / "map/orthomosaic.png"), cv2.IMREAD_UNCHANGED)
    size, _, _, _, west, north = map(float, (result / "map/orthomosaic.pgw").read_text().split())
    x, y = np.meshgrid(west + size * np.arange(picture.shape[1]), north - size * np.arange(picture.shape[0]))
    true, drawn = (
        cv2.blur(grey.astype(np.float32), (7, 7)) for grey in (ground_of(SCENARIO).grey(x, y), picture[..., 0])
    )
    inside = cv2.erode(picture[..., 3], np.ones((9, 9))) > 0
    assert inside.mean() > 0.5
    assert np.corrcoef(true[inside], drawn[inside])[0, 1] > 0.9
    figures = json.loads((result / "map/map.json").read_text())
    assert figures["orthomosaic"]["seam_px"] < 1.0
    assert figures["model"]["bytes"] == (result / "map/model.glb").stat().st_size <= 3_000_000
    assert {"model.ply", "height.tif", "orthomosaic.jpg"} <= {path.name for path in (result / "map").iterdir()}


def test_a_flight_that_has_been_run_gives_the_same_map(
    result: Path, bag: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = (result / "map/map.json").read_bytes()
    assert main(["map", str(result)]) == 2
    assert "exists already" in capsys.readouterr().err
    shutil.move(result / "map", result / "before")
    assert main(["map", str(result), "--cell", "1"]) == 0
    assert "processor time for a frame flown" in capsys.readouterr().out
    assert (result / "map/map.json").read_bytes() == first
    for tile in (result / "before/tiles").glob("*.npz"):
        assert np.array_equal(np.load(tile)["cells"], np.load(result / "map/tiles" / tile.name)["cells"])
    shutil.rmtree(result / "map")
    options = ["--bags", str(bag), "--vehicles", "uav2", "--cell", "1", "--pixel", "0.3"]
    options += ["--datum=-28.2325,153.0012,20", "--yaw", "30"]
    axes: list[str] = []
    monkeypatch.setattr(
        "uav_vslam.report.height_picture.save", lambda drawn, _: axes.append(drawn.axes[0].get_ylabel())
    )
    assert main(["map", str(result), *options]) == 0
    assert axes == ["y [m]", "y [m]"]  # not north
    tree = json.loads((result / "map/map.json").read_text())
    assert list(tree["vehicles"]) == ["uav2"]
    assert not tree["north_up"]
    assert tree["orthomosaic"]["m_per_px"] == 0.3
    assert tree["datum"] == {"latitude_deg": -28.2325, "longitude_deg": 153.0012, "height_m": 20.0, "yaw_deg": 30.0}
    assert not (result / "map/orthomosaic.png").exists()
    datum = Datum(-28.2325, 153.0012, 20.0, yaw_deg=30.0)
    raster = HeightGrid.open(result / "map/tiles").extent
    north_west = to_geodetic(np.array([[raster.x[0], raster.y[-1], 0.0]]), datum)[0]
    assert place(result / "map/height.tif", 0, 0) == pytest.approx(north_west[:2], abs=1e-8)  # a millimetre
    with tifffile.TiffFile(result / "map/orthomosaic.tif") as picture:
        assert picture.pages[0].geotiff_tags["ProjNatOriginLatGeoKey"] == -28.2325


@pytest.mark.parametrize(
    ("sides_m", "pixel_m"), [((1000.0, 2000.0), 0.1), ((1000.0, 2100.0), 0.15), ((4000.0, 4000.0), 0.3)]
)
def test_a_large_picture_has_larger_pixels_and_that_is_told(
    sides_m: tuple[float, float], pixel_m: float, capsys: pytest.CaptureFixture[str]
) -> None:
    columns, rows = (round(side_m / 0.5) for side_m in sides_m)
    assert default_pixel_m(Raster(0.5, -columns // 2, 0, columns, rows)) == pixel_m
    said = capsys.readouterr().err
    assert (f"{pixel_m:g} m wide" in said) == ("--pixel M" in said) == (pixel_m > 0.1)


@pytest.mark.parametrize(
    ("options", "allowed"),
    [
        (["map", "--cell", "1e9"], "a number above 0 and at most 100 [m]"),
        (["map", "--pixel", "1e9"], "a number above 0 and at most 50 [m]"),
        (["mosaic", "--pixel", "0"], "a number above 0 and at most 50 [m]"),
    ],
)
def test_a_side_with_which_there_is_no_map_is_refused(
    options: list[str], allowed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([*options, str(tmp_path)])
    assert f"is not {allowed}" in capsys.readouterr().err


def flown_only(result: Path, folder: Path) -> Path:
    """Return a copy of the flight, without its map."""
    return Path(shutil.copytree(result, folder / "result", ignore=shutil.ignore_patterns("map", "before")))


def test_a_map_goes_to_the_flight_that_latest_named_at_the_start(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another run that ends meanwhile moves `results/latest`."""
    flight, latest, other = flown_only(result, tmp_path), tmp_path / "latest", tmp_path / "other"
    latest.symlink_to(flight.name)
    other.mkdir()

    def moved(*args: Any) -> int:
        latest.unlink()
        latest.symlink_to(other.name)
        return write_map(*args)

    monkeypatch.setattr("uav_vslam.cli.map.write_map", moved)
    assert main(["map", str(latest), "--cell", "2"]) == 0
    assert (flight / "map/map.json").is_file()
    assert (flight / "report.html").is_file()
    assert not list(other.iterdir())


def test_the_axes_of_a_frame_that_a_start_defines_are_not_called_east_and_north(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy, axes = flown_only(result, tmp_path), []
    config = (copy / "config.yaml").read_text()
    (copy / "config.yaml").write_text(config.replace("method: given", "method: in_flight"))
    monkeypatch.setattr(
        "uav_vslam.report.height_picture.save", lambda drawn, _: axes.append(drawn.axes[0].get_xlabel())
    )
    assert main(["map", str(copy), "--vehicles", "uav1", "--cell", "2"]) == 0
    assert axes == ["x [m]", "x [m]"]
    assert not json.loads((copy / "map/map.json").read_text())["north_up"]
    assert "x to the right, y up" in (copy / "report.html").read_text()


def test_cells_smaller_than_the_pixels_are_told_with_a_size_that_suits(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = flown_only(result, tmp_path)
    assert main(["map", str(flown), "--cell", "0.1"]) == 1
    said = capsys.readouterr().err
    assert "pairs have pixels too large for cells of 0.1 m; use --cell 0." in said
    assert "nothing was mapped: no pair of views gave a height" in said  # though they show the ground
    assert main(["map", str(flown), "--cell", "1", "--no-plots"]) == 0


def test_views_ahead_are_told_that_only_what_is_below_is_mapped() -> None:
    mapper = SurfaceMapper(HeightGrid(1.0), SurfaceSettings(scale=1.0))
    for k in range(6):
        mapper.add_view(view(k))
    assert list(doubts(mapper)) == []
    ahead = so3_exp([0.0, np.deg2rad(-80.0), 0.0])
    for k in range(6, 40):
        T_map_cam = Pose(ahead @ pose(k).R, pose(k).t)
        mapper.add_view(dataclasses.replace(view(0), stamp_ns=view(k).stamp_ns, T_map_cam=T_map_cam))
    (said,) = doubts(mapper)
    assert "do not look down on ground that both show" in said


def test_another_recording_than_that_of_the_poses_is_told(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Simulated ones all begin at the same stamp."""
    said = []
    for seed in (SCENARIO.seed, SCENARIO.seed + 90):
        other = tmp_path / f"{seed}"
        record(dataclasses.replace(SCENARIO, seed=seed), other, coding=ImageCoding("png"))
        poses = flown_only(result, tmp_path / f"of_{seed}")
        main(["map", str(poses), "--bags", str(other), "--cell", "1", "--no-plots"])
        said.append("most pairs of views have few matches" in capsys.readouterr().err)
    assert said == [False, True]


@pytest.mark.parametrize(
    ("change", "words", "message"),
    [
        ({}, ["--vehicles", "uav9"], "no flight of uav9"),
        ({"bags": []}, [], "names no recordings"),
        ({"bags": ["/nowhere"]}, [], "/nowhere"),
        ({}, ["--set", "backend.sigma_px=2"], "a flight that has been run: --set has no effect"),
        ({}, ["--no-smoothing"], "--no-smoothing has no effect"),
        ({}, ["--results", "elsewhere"], "--results has no effect"),
    ],
)
def test_what_is_missing_or_comes_too_late_is_named_in_one_line(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict, words: list[str], message: str
) -> None:
    copy = flown_only(result, tmp_path)
    tree = json.loads((copy / "summary.json").read_text())
    (copy / "summary.json").write_text(json.dumps(tree | change))
    assert main(["map", str(copy), *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (copy / "map").exists()


def test_an_interrupted_map_leaves_nothing_and_one_that_was_killed_is_started_again(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "result"
    shutil.copytree(result, copy, ignore=shutil.ignore_patterns("map", "before"))
    before = sorted(copy.iterdir())
    (copy / "map.partial/map/tiles").mkdir(parents=True)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("uav_vslam.cli.map_picture.write_picture_and_model", interrupt)
    assert main(["map", str(copy), "--vehicles", "uav1", "--cell", "2"]) == 130
    assert "map.partial, left by work that was cut short, is removed" in capsys.readouterr().err
    assert sorted(copy.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--yaw", "30"], "--datum LAT LON ALT"),
        (["--datum", "91", "0", "0"], "latitude 91 of the datum"),
        (["--config", "sample", "--set", "fusion.common_origin=false"], "(fusion.common_origin: false); map one of"),
        (["--config", "sample", "--set", "start.method=in_flight"], "(start.method: static or in_flight); map one of"),
    ],
)
def test_what_can_not_be_mapped_is_refused_before_anything_is_flown(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main(["map", str(bag), "--results", str(tmp_path), *words]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_bags_are_refused_without_a_result(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", str(bag), "--bags", str(bag)]) == 2
    assert "goes with a results folder" in capsys.readouterr().err
