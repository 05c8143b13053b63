# SPDX-License-Identifier: Apache-2.0
"""Plots that need no ground truth."""

import dataclasses

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection

from uav_vslam.report.contact_sheet import contact_sheet
from uav_vslam.report.landmark_view import horizontal_ellipses, landmark_view
from uav_vslam.report.plots import write_plots
from uav_vslam.report.quality_plot import COASTED, EVENT, quality_plot
from uav_vslam.types import FrameQuality, MappedLandmarks

DARK = (20, 21, 60)


def frame(k: int) -> FrameQuality:
    dark = k in DARK
    events = ("something",) if k == 40 else ()
    return FrameQuality(
        10**18 + 100_000_000 * k, 90, 80, 25, 0, 60, dark, False, False, 0, 0.0 if dark else 90.0 + k,
        0 if dark else 100, 0.99, events,
    )  # fmt: skip


@pytest.fixture
def judged(blind):
    """The flight without ground truth, with frames, and landmarks whose sigmas are 2 m north, 1 m east, 9 m up."""
    ids = np.arange(50, dtype=np.uint32)
    positions = np.column_stack([4.0 * ids, 20.0 * np.sin(ids), np.zeros(50)])
    landmarks = MappedLandmarks(ids, positions, np.tile(np.diag([1.0, 4.0, 81.0]), (50, 1, 1)))
    vehicle = dataclasses.replace(blind.vehicles["uav1"], frames=tuple(map(frame, range(100))), landmarks=landmarks)
    return dataclasses.replace(blind, vehicles={"uav1": vehicle})


def test_without_truth_the_quality_and_the_landmarks_are_drawn(judged, tmp_path):
    names = [path.name for path in write_plots(judged, tmp_path)]
    assert names == ["plan_view.png", "quality.png", "landmarks.png"]


def test_a_flight_without_any_visual_update_is_drawn(judged, tmp_path):
    vehicle = judged.vehicles["uav1"]
    dark = tuple(dataclasses.replace(frame, coasted=True, nis=0.0, dof=0) for frame in vehicle.frames)
    vehicles = {name: dataclasses.replace(vehicle, name=name, frames=dark) for name in ("uav1", "uav2")}
    flight = dataclasses.replace(judged, vehicles=vehicles)
    assert "quality.png" in [path.name for path in write_plots(flight, tmp_path)]


def test_without_records_neither_is_drawn(blind):
    assert quality_plot(blind) is None
    assert landmark_view(blind) is None


def test_innovations_points_and_claims_are_those_of_the_frames(judged):
    nis, points, position, heading = quality_plot(judged).axes
    seconds, values = next(line for line in nis.lines if line.get_label() == "NIS / dof").get_data()
    updated = [k for k in range(100) if k not in DARK]
    np.testing.assert_allclose(seconds, 0.1 * np.array(updated))
    np.testing.assert_allclose(values, 0.9 + 0.01 * np.array(updated))
    assert len([patch for patch in nis.patches if patch.get_facecolor()[:3] == pytest.approx(_rgb(COASTED))]) == 3
    assert [line.get_xdata()[0] for line in points.lines if line.get_color() == EVENT] == [pytest.approx(4.0)]
    np.testing.assert_allclose(position.lines[-1].get_ydata(), 0.5 * np.sqrt(3))
    np.testing.assert_allclose(heading.lines[-1].get_ydata(), np.degrees(0.5))


def test_the_calibration_is_drawn_where_it_is_estimated(judged):
    """The clocks, 0.2 ms apart, in all frames but the first; the disparity never."""
    vehicle = judged.vehicles["uav1"]
    first, *others = vehicle.frames
    frames = (first, *(dataclasses.replace(f, time_offset_s=-2e-4, time_offset_sigma_s=1e-4) for f in others))
    vehicles = {"uav1": dataclasses.replace(vehicle, frames=frames)}
    drawn = quality_plot(dataclasses.replace(judged, vehicles=vehicles))
    offset, (legend,) = drawn.axes[4:], drawn.legends
    assert [axes.get_ylabel() for axes in offset] == ["Time offset ±1σ [ms]"]
    np.testing.assert_allclose(offset[0].lines[-1].get_ydata(), [np.nan, *[-0.2] * 99])
    low, high = offset[0].collections[-1].get_datalim(offset[0].transData).intervaly
    assert (low, high) == pytest.approx((-0.3, -0.1))
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["95 % band", "NIS / dof", "features", "tracked", "associated", "±1σ"]
    colours = [tuple(patch.get_facecolor()) for patch in legend.get_patches()]
    assert len(set(colours)) == 2  # the sigma does not look like a band


def test_the_scale_of_a_row_holds_what_every_vehicle_has_in_it(judged):
    """The second vehicle has more features than the first, whose scale it shares."""
    first = judged.vehicles["uav1"]
    many = tuple(dataclasses.replace(frame(k), features=400) for k in range(100))
    second = dataclasses.replace(first, name="uav2", frames=many)
    axes = quality_plot(dataclasses.replace(judged, vehicles={"uav1": first, "uav2": second})).axes
    for row in axes[2:]:  # below the innovations, whose scale is logarithmic
        low, high = row.get_ylim()
        assert low == 0
        assert high > max(np.max(line.get_ydata()) for line in row.lines if line.get_color() != EVENT)


def _rgb(colour):
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))


def test_ellipses_are_those_of_the_horizontal_covariance():
    turn = np.radians(30.0)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    semi_axes, angles_deg = horizontal_ellipses((R @ np.diag([9.0, 1.0, 100.0]) @ R.T)[None])
    np.testing.assert_allclose(semi_axes, [[3.0, 1.0]])
    assert angles_deg[0] % 180.0 == pytest.approx(30.0)
    assert horizontal_ellipses(np.zeros((0, 3, 3)))[0].shape == (0, 2)


def test_landmarks_are_drawn_true_to_scale_where_they_can_be_seen(judged):
    axes = landmark_view(judged).axes[0]
    (drawn,) = [one for one in axes.collections if isinstance(one, EllipseCollection)]
    np.testing.assert_allclose(drawn.get_widths(), 2 * 2.0)
    np.testing.assert_allclose(drawn.get_heights(), 2 * 1.0)
    np.testing.assert_allclose(drawn.get_angles() % 180.0, 90.0)
    assert "drawn" not in axes.get_title()


def test_ellipses_too_small_to_be_seen_are_enlarged_and_the_title_says_by_how_much(judged):
    landmarks = judged.vehicles["uav1"].landmarks
    sharp = dataclasses.replace(landmarks, covariances=1e-4 * landmarks.covariances)
    vehicle = dataclasses.replace(judged.vehicles["uav1"], landmarks=sharp)
    axes = landmark_view(dataclasses.replace(judged, vehicles={"uav1": vehicle})).axes[0]
    (drawn,) = [one for one in axes.collections if isinstance(one, EllipseCollection)]
    np.testing.assert_allclose(drawn.get_widths(), 50 * 2 * 0.02)
    assert "drawn 50 times as large" in axes.get_title()


def test_a_dense_map_shows_all_landmarks_but_only_some_ellipses(judged, monkeypatch):
    monkeypatch.setattr("uav_vslam.report.landmark_view.MOST_ELLIPSES", 20)
    axes = landmark_view(judged).axes[0]
    (drawn,) = [one for one in axes.collections if isinstance(one, EllipseCollection)]
    assert len(drawn.get_widths()) == 20
    (dots,) = [line for line in axes.lines if line.get_marker() == "."]
    assert len(dots.get_xdata()) == 50


def test_a_contact_sheet_holds_each_picture_with_its_caption():
    images = [np.full((30, 40, 3), (k, 0, 255), np.uint8) for k in range(6)]
    figure = contact_sheet([(image, f"number {k}") for k, image in enumerate(images)], "sheet")
    shown = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in shown] == [f"number {k}" for k in range(6)]
    np.testing.assert_array_equal(shown[5].images[0].get_array(), np.full((30, 40, 3), (255, 0, 5)))  # as RGB
    assert contact_sheet([], "empty") is None
