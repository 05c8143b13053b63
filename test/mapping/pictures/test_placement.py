# SPDX-License-Identifier: Apache-2.0
"""Scale and place of a reconstruction: by the height that is given, or by GPS, even if its receiver was stuck."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum, to_geodetic
from uav_vslam.geometry.rotation import rotation_from_rpy
from uav_vslam.mapping.pictures.bundle import Scene
from uav_vslam.mapping.pictures.gps_positions import local_positions
from uav_vslam.mapping.pictures.lens import PARAMETERS, project
from uav_vslam.mapping.pictures.picture import Geodetic, Picture
from uav_vslam.mapping.pictures.placement import HEIGHT_WITHOUT_SCALE, Placement, levelled, place
from uav_vslam.mapping.pictures.procedure import Adjusted
from uav_vslam.mapping.pictures.robust_fits import ground_plane
from uav_vslam.mapping.pictures.tracks import Tracks

Array = NDArray[np.float64]

HEIGHT_M = 50.0
SIDE, SPACING_M = 5, 15.0
WIDTH, HEIGHT, FOCAL_PX = 1000, 750, 900.0
DATUM = Datum(-28.0, 153.0, 20.0)
SCALE = 0.02  # of a reconstruction by pictures alone


@pytest.fixture(scope="module")
def flown() -> tuple[Array, Adjusted]:
    """Return true (25, 3) positions [m], and the adjusted pictures in a frame of their own scale."""
    rng = np.random.default_rng(1)
    count = SIDE * SIDE
    x, y = np.meshgrid(SPACING_M * np.arange(SIDE), SPACING_M * np.arange(SIDE))
    centres = np.column_stack([x.ravel(), y.ravel(), HEIGHT_M + rng.normal(0, 2, count)])
    ground = np.column_stack([rng.uniform(-25, 85, (1500, 2)), rng.normal(0, 1.5, 1500)])
    R, lens = np.tile(np.diag([1.0, -1.0, -1.0]), (count, 1, 1)), np.array([[np.log(FOCAL_PX), 0, 0, 0, 0]])
    pictures, points, pixels = [], [], []
    for k in range(count):
        seen = project((ground - centres[k]) @ R[k].T, np.repeat(lens, len(ground), 0))
        inside = np.flatnonzero((abs(seen[:, 0]) < WIDTH / 2) & (abs(seen[:, 1]) < HEIGHT / 2))
        pictures += [k] * len(inside)
        points += inside.tolist()
        pixels.append(seen[inside] + rng.normal(0, 0.3, (len(inside), 2)))
    order = np.lexsort((pictures, points))
    tracks = Tracks(np.array(pictures)[order], np.array(points)[order], np.vstack(pixels)[order], len(ground))
    every = np.ones(len(order), bool)
    scene = Scene(R, SCALE * centres, lens, np.zeros(count, int), SCALE * ground[tracks.of(every)])
    return centres, Adjusted(scene, tracks.chosen(every), np.arange(count), 0.3, np.zeros((1, PARAMETERS)))


def pictures_at(positions: Array, datum: Datum = DATUM) -> list[Picture]:
    """Return pictures with GPS at these positions; without where they are NaN."""
    geodetic = [
        None if np.isnan(up) else Geodetic(latitude, (longitude + 180.0) % 360.0 - 180.0, up)
        for longitude, latitude, up in to_geodetic(positions, datum)
    ]
    return [
        Picture(Path(f"{k}.jpg"), WIDTH, HEIGHT, False, "camera", FOCAL_PX, float(k), position)
        for k, position in enumerate(geodetic)
    ]


def placed(
    adjusted: Adjusted, positions: Array, height_m: float | None = None, datum: Datum = DATUM
) -> tuple[float, Placement]:
    """Return the height of the result [m], and its placement, with GPS at these positions."""
    pictures = pictures_at(positions, datum)
    result, placement = place(adjusted, pictures, height_m=height_m, focal_known=True)
    scene = result.scene
    return float(np.median(scene.centres[:, 2]) - np.median(scene.points[:, 2])), placement


def with_altitude(pictures: list[Picture], altitude_m: float) -> list[Picture]:
    return [
        replace(picture, position=replace(picture.position, height_m=altitude_m)) if picture.position else picture
        for picture in pictures
    ]


def gps(positions: Array, sigma_m: float = 1.0) -> Array:
    return positions + np.random.default_rng(2).normal(0, sigma_m, positions.shape)


@pytest.mark.parametrize("height_m", [45.0, 55.0])
def test_a_height_that_is_given_takes_precedence_over_gps(flown: tuple[Array, Adjusted], height_m: float) -> None:
    height, placement = placed(flown[1], gps(flown[0]), height_m)
    assert height == pytest.approx(height_m, rel=0.02)
    assert placement.scale == "height"
    assert placement.gps_m is not None


def test_a_receiver_that_is_stuck_for_most_of_the_flight_is_no_scale(flown: tuple[Array, Adjusted]) -> None:
    positions = gps(flown[0])
    positions[8:23] = positions[8]
    height, placement = placed(flown[1], positions)
    assert height == pytest.approx(HEIGHT_M, rel=0.1)
    assert placement.scale == "gps"
    assert placement.wrong
    assert set(placement.wrong) <= set(range(9, 23))


def test_one_position_for_all_pictures_is_none(flown: tuple[Array, Adjusted]) -> None:
    _, placement = placed(flown[1], np.tile(flown[0][:1], (SIDE * SIDE, 1)))
    assert placement.scale == "none"


def only(positions: Array, count: int, wrong_m: float = 0.0) -> Array:
    """Return the positions of so many pictures, the first one wrong by so much, and NaN for the others."""
    known = np.full_like(positions, np.nan)
    corners = [0, SIDE - 1, SIDE * SIDE - 1, SIDE * (SIDE - 1)][:count]
    known[corners] = positions[corners]
    known[0, :2] += wrong_m
    return known


@pytest.mark.parametrize("wrong_m", [0.0, 150.0])
def test_three_positions_give_a_scale_but_can_t_be_checked(flown: tuple[Array, Adjusted], wrong_m: float) -> None:
    height, placement = placed(flown[1], only(gps(flown[0]), 3, wrong_m))
    assert placement.scale == "gps"
    assert not placement.checked
    assert not placement.believed
    assert placement.gps_m is not None
    if wrong_m:  # two of three are not taken for right
        assert np.nanmin(placement.gps_m) > 10.0
    else:
        assert height == pytest.approx(HEIGHT_M, rel=0.1)


@pytest.mark.slow
def test_four_positions_are_checked(flown: tuple[Array, Adjusted]) -> None:
    _, placement = placed(flown[1], only(gps(flown[0]), 4))
    assert placement.checked
    assert placement.believed
    _, placement = placed(flown[1], only(gps(flown[0]), 4, 150.0))
    assert placement.checked
    assert placement.gps_m is not None
    assert np.nanmax(placement.gps_m) > 50.0


@pytest.mark.parametrize("height_m", [None, 45.0])
def test_positions_in_a_wrong_order_give_no_scale(flown: tuple[Array, Adjusted], height_m: float | None) -> None:
    """The best fit of such positions shrinks the flight to a point: 2 instead of 50 m above the ground."""
    mixed = flown[0][np.random.default_rng(3).permutation(SIDE * SIDE)]
    height, placement = placed(flown[1], mixed, height_m)
    assert placement.unrelated
    assert placement.datum is None
    assert placement.scale == ("none" if height_m is None else "height")
    assert height == pytest.approx(height_m or HEIGHT_WITHOUT_SCALE, rel=0.02)


def test_latitude_and_longitude_exchanged_are_not_believed(flown: tuple[Array, Adjusted]) -> None:
    pictures = [
        replace(picture, position=Geodetic(position.longitude_deg, position.latitude_deg, position.height_m))
        for picture in pictures_at(gps(flown[0]), Datum(48.2, 16.4, 300.0))
        if (position := picture.position)
    ]
    _, placement = place(flown[1], pictures, height_m=None, focal_known=True)
    assert placement.unrelated
    assert placement.scale == "none"


def slope_errors(adjusted: Adjusted, positions: Array, heights_m: Array) -> tuple[Array, Placement]:
    """Return errors of the centres' heights [m], up to a common one, with GPS at these positions; and the placement."""
    result, placement = place(adjusted, pictures_at(positions), height_m=None, focal_known=True)
    error = result.scene.centres[:, 2] - heights_m
    return error - np.median(error), placement


@pytest.mark.parametrize("slope_deg", [3.0, 15.0])
def test_on_a_hillside_the_positions_tell_the_slope(flown: tuple[Array, Adjusted], slope_deg: float) -> None:
    """Level ground was believed: heights wrong by metres at the edges, and above 5 degrees GPS was said to be wrong."""
    hill = flown[0] @ rotation_from_rpy(np.deg2rad(slope_deg), 0.0, 0.5).T
    errors, placement = slope_errors(flown[1], gps(hill, 0.5), hill[:, 2])
    assert placement.believed
    assert placement.wrong == ()
    assert np.abs(errors).max() < 1.0


def test_a_strip_tells_the_slope_along_itself_only(flown: tuple[Array, Adjusted]) -> None:
    strip = np.where(np.arange(SIDE * SIDE)[:, None] % SIDE == 0, flown[0], np.nan)
    along, across = (flown[0] @ rotation_from_rpy(*np.deg2rad(turn), 0.0).T for turn in ((12.0, 0.0), (0.0, 12.0)))
    for hill, heights_m in ((along, along[:, 2]), (across, flown[0][:, 2])):
        errors, placement = slope_errors(flown[1], gps(np.where(np.isnan(strip), np.nan, hill), 0.1), heights_m)
        assert placement.believed
        assert np.abs(errors).max() < 1.0


def test_altitudes_that_drift_by_most_of_the_height_are_no_slope(flown: tuple[Array, Adjusted]) -> None:
    drifting = gps(flown[0]) + np.outer(np.arange(SIDE * SIDE), [0.0, 0.0, 2.0])
    errors, placement = slope_errors(flown[1], drifting, flown[0][:, 2])
    assert placement.altitudes_off_m == pytest.approx(12.5, abs=2.0)  # a quarter of the drift
    assert np.abs(errors).max() < 0.5


def test_altitudes_that_drift_leave_the_positions_in_the_plane_to_be_used(flown: tuple[Array, Adjusted]) -> None:
    drifting = gps(flown[0]) + np.outer(np.arange(SIDE * SIDE), [0.0, 0.0, 2.0])
    drifting[7, 0] += 40.0
    height_m, placement = placed(flown[1], drifting)
    assert placement.believed
    assert placement.wrong == (7,)
    assert height_m == pytest.approx(HEIGHT_M, rel=0.02)


@pytest.mark.slow
def test_one_altitude_for_all_pictures_does_not_tilt_the_ground(flown: tuple[Array, Adjusted]) -> None:
    """Pictures that rise by 6 m were laid level, and the ground fell by as much."""
    scene, tracks = flown[1].scene, flown[1].tracks
    rising = scene.centres + np.outer(scene.centres[:, 0], [0.0, 0.0, 0.1])
    points_cam = (scene.points[tracks.point] - rising[tracks.picture]) @ scene.R_cam_map[0].T  # all look straight down
    seen = project(points_cam, np.repeat(scene.lenses, len(points_cam), 0))
    climbing = replace(flown[1], scene=replace(scene, centres=rising), tracks=replace(tracks, pixels=seen))
    pictures = with_altitude(pictures_at(gps(flown[0])), 350.0)
    result, placement = place(climbing, pictures, height_m=None, focal_known=True)
    assert placement.believed
    assert placement.altitudes_equal
    assert placement.altitudes_off_m is None
    assert np.linalg.norm(ground_plane(result.scene.points)[0][:2]) < 0.01


def test_positions_on_both_sides_of_the_antimeridian_are_neighbours(flown: tuple[Array, Adjusted]) -> None:
    for longitude in (179.9995, 179.9999):  # most of them lie west of it, then east
        datum = Datum(-16.8, longitude, 20.0)
        pictures = pictures_at(flown[0], datum)
        assert {np.sign(each.position.longitude_deg) for each in pictures if each.position} == {-1.0, 1.0}
        positions, found = local_positions(pictures)
        assert found is not None
        assert -180.0 <= found.longitude_deg <= 180.0
        np.testing.assert_allclose(positions - positions[0], flown[0] - flown[0][0], atol=0.01)
        height, placement = placed(flown[1], gps(flown[0]), datum=datum)
        assert placement.believed
        assert height == pytest.approx(HEIGHT_M, rel=0.1)


def test_points_that_only_two_cameras_on_one_vehicle_see_do_not_tilt_the_ground(flown: tuple[Array, Adjusted]) -> None:
    scene, tracks = flown[1].scene, flown[1].tracks
    rng = np.random.default_rng(4)
    ray = np.column_stack([rng.uniform(-0.4, 0.4, (300, 2)), np.ones(300)])  # in the first camera's axes
    anywhere = scene.centres[0] + SCALE * HEIGHT_M * rng.uniform(0.5, 500.0, (300, 1)) * (ray @ scene.R_cam_map[0])
    twin = scene.centres[0] + SCALE * np.array([0.1, 0.0, 0.0])
    seen = [
        project((anywhere - c) @ scene.R_cam_map[0].T, scene.lenses.repeat(300, 0)) for c in (scene.centres[0], twin)
    ]
    more = Tracks(
        np.append(tracks.picture, np.tile([0, SIDE * SIDE], 300)),
        np.append(tracks.point, tracks.count + np.arange(300).repeat(2)),
        np.vstack([tracks.pixels, np.stack(seen, axis=1).reshape(-1, 2)]),
        tracks.count + 300,
    )
    both = replace(
        scene,
        R_cam_map=np.vstack([scene.R_cam_map, scene.R_cam_map[:1]]),
        centres=np.vstack([scene.centres, twin]),
        lens_of=np.append(scene.lens_of, 0),
        points=np.vstack([scene.points, anywhere]),
    )
    level = levelled(replace(flown[1], scene=both, tracks=more, used=np.arange(SIDE * SIDE + 1)))
    np.testing.assert_allclose(level.scene.R_cam_map[:, 2], levelled(flown[1]).scene.R_cam_map[[0] * 26, 2], atol=1e-9)
