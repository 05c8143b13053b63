# SPDX-License-Identifier: Apache-2.0
"""Rendered pictures with known poses: what is recovered, and what the user is warned of."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from picture_folder import DATUM, FOCAL_PX, HEIGHT_M, SIZE, PictureFlight, flight, render, write
from similarity_errors import similarity_errors

from uav_vslam.errors import PictureError
from uav_vslam.evaluation.files.geodetic import Datum, from_geodetic, to_geodetic
from uav_vslam.mapping.pictures.features import PictureFeatures, detect
from uav_vslam.mapping.pictures.pairs import MatchedPair, candidates, match_all
from uav_vslam.mapping.pictures.picture import Geodetic, Picture
from uav_vslam.mapping.pictures.placement import Placement
from uav_vslam.mapping.pictures.reading import read_folder
from uav_vslam.mapping.pictures.reconstruction import Reconstruction, _about_gps, reconstruct

Array = NDArray[np.float64]
Matched = tuple[tuple[Picture, ...], list[PictureFeatures], list[MatchedPair]]

EXTENT_M = 90.0
CENTRE_M = 0.002 * EXTENT_M  # a twentieth of a pixel on the ground is 1 cm; a principal point 0.7 px off, 17 cm


def matched(flown: PictureFlight, folder: Path, *, left_out: Sequence[int] = ()) -> Matched:
    kept = [k for k in range(len(flown.poses)) if k not in left_out]
    flown = replace(flown, poses=tuple(flown.poses[k] for k in kept))
    pictures = read_folder(write(render(flown), flown.names(), folder)).pictures
    features = [detect(picture.read()) for picture in pictures]
    unknown = np.full((len(pictures), 2), np.nan)
    sides = [max(picture.width, picture.height) for picture in pictures]
    return pictures, features, match_all(features, sides, candidates(features, unknown))


HILLY = flight(2, 5)
FLAT = flight(2, 3, tilt_deg=0.0, relief_m=0.0, wander_m=0.0, distortion=np.zeros(5))


@pytest.fixture(scope="module")
def hilly(tmp_path_factory: pytest.TempPathFactory) -> Matched:
    """Pictures of rolling ground."""
    return matched(HILLY, tmp_path_factory.mktemp("hilly"))


@pytest.fixture(scope="module")
def alone(hilly: Matched) -> Reconstruction:
    """What pictures alone tell."""
    return reconstruct(*hilly)


def with_gps(data: Matched, positions: Array) -> Matched:
    geodetic = to_geodetic(positions, DATUM).tolist()
    rows = [Geodetic(latitude, longitude, height) for longitude, latitude, height in geodetic]
    pictures = tuple(replace(picture, position=row) for picture, row in zip(data[0], rows, strict=True))
    return pictures, data[1], data[2]


def local_errors(found: Reconstruction, truth: Array) -> Array:
    """Return (N, 3) errors of the centres in the datum of the truth [m]."""
    assert found.placement.datum is not None
    geodetic = to_geodetic(found.adjusted.scene.centres, found.placement.datum)
    return np.asarray(from_geodetic(geodetic, DATUM) - truth)


@pytest.mark.slow
def test_poses_are_recovered_up_to_a_similarity(alone: Reconstruction) -> None:
    assert alone.adjusted.used.tolist() == list(range(len(HILLY.poses)))
    assert similarity_errors(alone.adjusted.scene.centres, HILLY.centres).max() < CENTRE_M


def test_relief_and_tilt_calibrate_the_focal_length(alone: Reconstruction) -> None:
    lens, sigma = alone.adjusted.scene.lenses[0], alone.adjusted.lens_sigmas[0]
    assert np.exp(lens[0]) == pytest.approx(FOCAL_PX, rel=0.02)
    assert lens[1] == pytest.approx(HILLY.camera.distortion[0], abs=0.02)
    assert sigma[0] < 0.02
    assert not any("focal length" in text for text in alone.warnings)


@pytest.mark.slow
def test_a_principal_point_off_the_centre_is_found(tmp_path: Path) -> None:
    camera = replace(HILLY.camera, cx=HILLY.camera.cx + 2.5, cy=HILLY.camera.cy - 2.0)
    found = reconstruct(*matched(replace(HILLY, camera=camera), tmp_path))
    lens, sigma = found.adjusted.scene.lenses[0], found.adjusted.lens_sigmas[0]
    assert np.exp(lens[0]) * lens[3:] == pytest.approx([2.5, -2.0], abs=0.8)  # held at 0 it would be 2.5 off
    assert abs(lens[0] - np.log(FOCAL_PX)) < 3.0 * sigma[0]
    assert similarity_errors(found.adjusted.scene.centres, HILLY.centres).max() < CENTRE_M


def test_without_gps_the_scale_is_said_to_be_arbitrary(alone: Reconstruction, hilly: Matched) -> None:
    assert any("scale is arbitrary" in text for text in alone.warnings)
    known = reconstruct(*hilly, height_m=HEIGHT_M)
    assert known.height_m == pytest.approx(HEIGHT_M, rel=0.01)
    assert not any("scale" in text for text in known.warnings)


def test_flat_ground_from_straight_above_leaves_the_focal_length_open(tmp_path: Path) -> None:
    data = matched(FLAT, tmp_path)
    found = reconstruct(*data)
    assert found.adjusted.lens_sigmas[0, 0] > 0.1
    assert any("focal length" in text and "--focal-px" in text for text in found.warnings)
    pictures = tuple(replace(picture, focal_px=FOCAL_PX) for picture in data[0])
    given = reconstruct(pictures, data[1], data[2], focal_known=True)
    assert np.exp(given.adjusted.scene.lenses[0, 0]) == pytest.approx(FOCAL_PX, rel=1e-12)
    assert not any("focal length" in text for text in given.warnings)
    assert similarity_errors(given.adjusted.scene.centres, FLAT.centres).max() < CENTRE_M


def test_agreeing_gps_places_the_map_in_metres(hilly: Matched) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.5, HILLY.centres.shape)
    found = reconstruct(*with_gps(hilly, HILLY.centres + noise))
    assert found.placement.believed
    assert found.placement.wrong == ()
    assert np.abs(local_errors(found, HILLY.centres)).max() < 1.0
    assert found.warnings == ()


def test_a_single_wrong_position_is_named_and_has_no_influence(hilly: Matched) -> None:
    positions = HILLY.centres + np.random.default_rng(1).normal(0.0, 0.5, HILLY.centres.shape)
    positions[3] += [40.0, -25.0, 10.0]
    found = reconstruct(*with_gps(hilly, positions))
    assert found.placement.wrong == (3,)
    assert any("picture_003.png" in text for text in found.warnings)
    assert np.abs(local_errors(found, HILLY.centres)).max() < 1.5


def test_gps_that_contradicts_the_pictures_bends_nothing(hilly: Matched, alone: Reconstruction) -> None:
    walk = np.cumsum(np.random.default_rng(6).normal(0.0, 12.0, HILLY.centres.shape), axis=0)
    found = reconstruct(*with_gps(hilly, HILLY.centres + walk))
    assert not found.placement.believed
    (said,) = [text for text in found.warnings if "GPS contradicts the pictures" in text]
    assert "m off (median; " in said
    assert "m from 10 to 90 %)" in said
    assert similarity_errors(found.adjusted.scene.centres, alone.adjusted.scene.centres).max() < 1e-6


def test_pictures_without_overlap_are_named_and_left_out(tmp_path: Path) -> None:
    found = reconstruct(*matched(flight(1, 10), tmp_path, left_out=(5, 6, 7)))
    assert found.adjusted.used.tolist() == [0, 1, 2, 3, 4]
    assert any("2 of 7 pictures left out" in text and "picture_005.png" in text for text in found.warnings)


def test_the_surface_lies_below_all_of_two_pictures_that_hardly_overlap(tmp_path: Path) -> None:
    """The window ended near the points, in the overlap, and the mosaic showed a third of what the pictures show."""
    found = reconstruct(*matched(flight(1, 2, along_m=55.0, tilt_deg=0.0), tmp_path), height_m=HEIGHT_M)
    west, south, east, north = found.surface.raster.bounds_m
    half = 0.5 * HEIGHT_M * np.array(SIZE) / FOCAL_PX
    centres = found.adjusted.scene.centres[:, :2]
    assert (centres.min(axis=0) - 0.9 * half > [west, south]).all()
    assert (centres.max(axis=0) + 0.9 * half < [east, north]).all()


def test_pictures_of_different_places_are_an_error(hilly: Matched) -> None:
    with pytest.raises(PictureError, match="none of the 10 pictures"):
        reconstruct(hilly[0], hilly[1], [])


def test_positions_of_other_pictures_are_told() -> None:
    first, second = _about_gps([], Placement("none", None, None, False, (), unrelated=True))
    assert "as if its positions were those of others" in first
    assert "latitude and longitude not exchanged?" in first
    assert second.startswith("no GPS positions that agree, so the scale is arbitrary")


def test_too_few_positions_for_a_scale_are_not_called_none(hilly: Matched) -> None:
    placement = Placement("none", None, None, False, ())
    (text,) = _about_gps(with_gps(hilly, HILLY.centres)[0][:2], placement)
    assert text.startswith("fewer than 3 different GPS positions, so the scale is arbitrary")
    (text,) = _about_gps(hilly[0], placement)
    assert text.startswith("no GPS positions, so the scale is arbitrary")


def test_positions_that_nothing_checks_are_told() -> None:
    off = np.array([5.0, 9.2, 4.2, np.nan])
    (text,) = _about_gps([], Placement("gps", Datum(47.0, 8.0, 400.0), off, False, ()))
    assert text.startswith("only 3 different GPS positions: too few to check each other; scale, heading and position")
    assert "9 m off" in text


def test_a_given_height_that_gps_contradicts_is_doubted_too() -> None:
    """Twice the true height was taken for a fault of GPS."""
    off = np.full(9, 28.0)
    by_gps, given = (Placement(scale, Datum(47.0, 8.0, 400.0), off, False, ()) for scale in ("gps", "height"))
    (text,) = _about_gps([], given)
    assert text.startswith("GPS contradicts the pictures or the height given with --height: after the best fit")
    (text,) = _about_gps([], by_gps)
    assert text.startswith("GPS contradicts the pictures: after the best fit")


def test_altitudes_alone_that_contradict_the_pictures_are_told() -> None:
    (text,) = _about_gps([], Placement("gps", Datum(47.0, 8.0, 400.0), np.full(9, 1.2), True, (), altitudes_off_m=28.0))
    assert text.startswith("GPS altitudes contradict the pictures, by 28 m (median), and are not used")


def test_one_altitude_for_all_pictures_is_told() -> None:
    (text,) = _about_gps([], Placement("gps", Datum(47.0, 8.0, 0.0), np.full(9, 1.2), True, (), altitudes_equal=True))
    assert text.startswith("GPS altitudes are equal in all pictures")
