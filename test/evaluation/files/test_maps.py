# SPDX-License-Identifier: Apache-2.0
"""Positions on the ellipsoid, and the files that maps read."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.evaluation.files.geodetic import Datum, to_geodetic
from uav_vslam.evaluation.files.maps import KML, write_geojson, write_kml
from uav_vslam.evaluation.trajectory import Trajectory

KAGARU = Datum(-28.2325, 153.0012, 20.0)
DEGREE_NORTH_M = 110_791.0  # of latitude at 28.2 degrees: pi/180 a (1 - e^2) / (1 - e^2 sin^2 phi)^1.5


def test_the_example_of_epsg_guidance_note_7_2():
    """Method 9837: origin 55 N 5 E, 200 m; U, V, W of a point at 53 48 33.82 N, 2 07 46.38 E, 73.0 m."""
    position = np.array([[-189_013.869, -128_642.040, -4_220.171]])
    longitude, latitude, altitude_m = to_geodetic(position, Datum(55.0, 5.0, 200.0))[0]
    assert latitude == pytest.approx(53 + 48 / 60 + 33.82 / 3600, abs=5e-8)
    assert longitude == pytest.approx(2 + 7 / 60 + 46.38 / 3600, abs=5e-8)
    assert altitude_m == pytest.approx(73.0, abs=1e-3)


def test_the_maps_origin_is_the_datum_and_north_is_a_larger_latitude():
    corners = to_geodetic(np.array([[0.0, 0.0, 0.0], [0.0, 1000.0, 50.0], [1000.0, 0.0, 0.0]]), KAGARU)
    np.testing.assert_allclose(corners[0], [153.0012, -28.2325, 20.0], atol=1e-9)
    assert corners[1, 1] == pytest.approx(-28.2325 + 1000.0 / DEGREE_NORTH_M, rel=1e-5)
    assert corners[1, 2] == pytest.approx(70.0, abs=0.1)  # the tangent plane leaves the ellipsoid: 8 cm in 1 km
    assert corners[2, 0] > 153.0012


def test_a_yaw_turns_the_maps_x_axis_counter_clockwise_from_east():
    turned = Datum(-28.2325, 153.0012, 20.0, yaw_deg=90.0)
    forward, north = (
        to_geodetic(np.array([[100.0, 0.0, 0.0]]), turned),
        to_geodetic(np.array([[0.0, 100.0, 0.0]]), KAGARU),
    )
    np.testing.assert_allclose(forward, north, atol=1e-12)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((153.0, -28.0, 0.0), "latitude 153"),
        ((0.0, 200.0, 0.0), "longitude 200"),
        ((0.0, 0.0, float("nan")), "altitude nan"),
    ],
)
def test_an_impossible_datum_is_refused(values, expected):
    with pytest.raises(ConfigError, match=expected):
        Datum(*values)


def test_geojson_holds_a_line_per_track_longitude_first(truth, estimate, tmp_path):
    tree = json.loads(write_geojson({"a": truth, "b": estimate}, tmp_path / "f.geojson", KAGARU).read_text())
    assert [feature["properties"]["name"] for feature in tree["features"]] == ["a", "b"]
    assert tree["type"] == "FeatureCollection"
    line = tree["features"][1]["geometry"]
    assert line["type"] == "LineString"
    np.testing.assert_allclose(line["coordinates"], to_geodetic(estimate.positions, KAGARU), atol=5.1e-4)
    np.testing.assert_allclose(
        np.array(line["coordinates"])[:, :2], to_geodetic(estimate.positions, KAGARU)[:, :2], atol=1e-9
    )


def out_and_back() -> Trajectory:
    """Across the antimeridian, if the datum is on it."""
    positions = np.array([[-1000.0, 0, 0], [-500, 0, 0], [1500, 1000, 40], [500, 0, 0], [-500, 0, 0]])
    return Trajectory(np.arange(5), positions, np.tile([1.0, 0, 0, 0], (5, 1)))


def test_geojson_is_cut_on_the_antimeridian(tmp_path):
    """10 degrees north; 1 km is some 0.009 degrees of longitude."""
    text = write_geojson({"a": out_and_back()}, tmp_path / "f.geojson", Datum(10.0, 180.0, 0.0)).read_text()
    line = json.loads(text)["features"][0]["geometry"]
    assert line["type"] == "MultiLineString"
    west, east, back = map(np.array, line["coordinates"])
    assert [len(part) for part in (west, east, back)] == [3, 4, 2]
    assert [west[-1, 0], east[0, 0], east[-1, 0], back[0, 0]] == [180.0, -180.0, -180.0, 180.0]
    assert (west[:, 0] > 179).all()
    assert (east[:, 0] < -179).all()
    np.testing.assert_array_equal(west[-1, 1:], east[0, 1:])
    assert west[-1, 1] == pytest.approx(10.0 + 250.0 / DEGREE_NORTH_M, abs=1e-5)  # a quarter of the way
    assert west[-1, 2] == pytest.approx(10.0, abs=0.1)


def test_a_single_pose_is_a_point_of_geojson(truth, tmp_path):
    text = write_geojson({"a": truth.select(np.array([2]))}, tmp_path / "f.geojson", KAGARU).read_text()
    point = json.loads(text)["features"][0]["geometry"]
    assert point["type"] == "Point"
    np.testing.assert_allclose(point["coordinates"], to_geodetic(truth.positions[2:3], KAGARU)[0], atol=5.1e-4)


def test_kml_holds_a_line_per_track_at_absolute_altitude(truth, tmp_path):
    root = ElementTree.parse(write_kml({"uav1 <truth>": truth}, tmp_path / "f.kml", KAGARU)).getroot()
    assert root.tag == f"{{{KML}}}kml"
    place = root.find(f".//{{{KML}}}Placemark")
    assert place.find(f"{{{KML}}}name").text == "uav1 <truth>"
    assert place.find(f".//{{{KML}}}altitudeMode").text == "absolute"
    corners = [list(map(float, corner.split(","))) for corner in place.find(f".//{{{KML}}}coordinates").text.split()]
    np.testing.assert_allclose(corners, to_geodetic(truth.positions, KAGARU), atol=5.1e-4)


def test_kml_is_cut_where_geojson_is(tmp_path):
    datum = Datum(10.0, 180.0, 0.0)
    place = ElementTree.parse(write_kml({"a": out_and_back()}, tmp_path / "f.kml", datum)).find(
        f".//{{{KML}}}Placemark"
    )
    lines = place.findall(f"{{{KML}}}MultiGeometry/{{{KML}}}LineString")
    assert [line.find(f"{{{KML}}}altitudeMode").text for line in lines] == ["absolute"] * 3
    parts = [
        [list(map(float, corner.split(","))) for corner in line.find(f"{{{KML}}}coordinates").text.split()]
        for line in lines
    ]
    text = write_geojson({"a": out_and_back()}, tmp_path / "f.geojson", datum).read_text()
    assert parts == json.loads(text)["features"][0]["geometry"]["coordinates"]


def test_a_single_pose_is_a_point_of_kml(truth, tmp_path):
    root = ElementTree.parse(write_kml({"a": truth.select(np.array([2]))}, tmp_path / "f.kml", KAGARU))
    corner = root.find(f".//{{{KML}}}Placemark/{{{KML}}}Point/{{{KML}}}coordinates").text
    np.testing.assert_allclose(
        list(map(float, corner.split(","))), to_geodetic(truth.positions[2:3], KAGARU)[0], atol=5.1e-4
    )
