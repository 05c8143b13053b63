# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from rendered_views import pose, view

from uav_vslam.mapping.surface.prepared import PreparedView
from uav_vslam.mapping.surface.rectification import Depths, RectifiedPair, rectify

DEPTHS = Depths(-6.0, 0.0, 8.0)


def pair(bank_deg: float = 0.0, scale: float = 1.0, **more: object) -> RectifiedPair:
    left = PreparedView.of(view(0), scale)
    right = PreparedView.of(view(4, bank_deg=bank_deg), scale)
    found = rectify(left, right, DEPTHS, most=128, overlap=0.2, **more)  # type: ignore[arg-type]
    assert found is not None
    return found


def in_windows(pair: RectifiedPair, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) pixels of both windows, by the pinhole model alone."""
    found = []
    for camera, shift in ((pair.left, 0.0), (pair.right, pair.shift_px)):
        rect = (points - camera.T_map_cam.t) @ pair.R_map_rect
        pixels = pair.focal_px * rect[:, :2] / rect[:, 2:] - pair.corner_px
        found.append(pixels + np.array([shift, 0.0]))
    return found[0], found[1]


@pytest.mark.parametrize("bank_deg", [0.0, 12.0])
def test_a_point_is_in_one_row_of_both_windows_and_its_disparity_gives_it_back(bank_deg: float) -> None:
    rectified = pair(bank_deg)
    points = np.random.default_rng(1).uniform([2.0, -8.0, -4.0], [12.0, 8.0, 6.0], (50, 3))
    left, right = in_windows(rectified, points)
    assert left[:, 1] == pytest.approx(right[:, 1], abs=1e-9)
    disparity = np.full(rectified.size[::-1], 0.0, np.float32)
    for (u, v), d in zip(np.rint(left).astype(int), (left - right)[:, 0], strict=True):
        disparity[v, u] = d
        chosen = np.zeros(disparity.shape, bool)
        chosen[v, u] = True
        back = rectified.points_map(disparity, chosen)[0]
        nearest = np.abs(points - back).max(axis=1).min()
        assert nearest < 0.1  # within half a pixel on the ground, as pixels are whole


def test_pixels_at_infinity_that_are_not_chosen_do_no_harm() -> None:
    """With a whole-numbered shift, the matcher's mark of an unknown disparity can be that of infinity."""
    rectified = replace(pair(), shift_px=14.0)
    disparity = np.full(rectified.size[::-1], -14.0, np.float32)
    disparity[0, :3] = 0.0
    points = rectified.points_map(disparity, disparity == 0.0)
    assert points.shape == (3, 3)
    assert np.isfinite(points).all()


def test_the_reference_height_has_no_disparity_and_the_searched_heights_have_room() -> None:
    rectified = pair()
    points = np.array([[5.0, 0.0, 0.0], [5.0, 0.0, DEPTHS.low_m], [5.0, 0.0, DEPTHS.high_m]])
    left, right = in_windows(rectified, points)
    middle, low, high = (left - right)[:, 0]
    assert middle == pytest.approx(0.0, abs=0.3)  # the reference is the corners' mean depth
    assert rectified.first <= low < middle < high <= rectified.first + rectified.count


def test_the_images_agree_where_the_ground_is_level_at_the_reference_height() -> None:
    left = PreparedView.of(view(0, 0.0), 1.0)
    right = PreparedView.of(view(4, 0.0), 1.0)
    found = rectify(left, right, DEPTHS, most=128, overlap=0.2)
    assert found is not None
    images = [image.astype(float) for image in found.images()]
    both = (images[0] > 0) & (images[1] > 0)
    assert both.sum() > 20_000
    assert np.corrcoef(images[0][both], images[1][both])[0, 1] > 0.9


def test_a_region_is_all_that_is_matched() -> None:
    region = np.array([[4.0, 2.0, 0.0], [8.0, 5.0, 0.0]])
    small, whole = pair(region=region), pair()
    assert small.size[1] < whole.size[1] / 2
    left, _ = in_windows(small, region)
    assert ((left > 0) & (left < small.size)).all()


def test_no_pair_without_overlap_or_with_a_baseline_along_the_view() -> None:
    first = PreparedView.of(view(0), 1.0)
    far = PreparedView(first.camera, pose(60), first.grey)
    assert rectify(first, far, DEPTHS, most=128, overlap=0.2) is None
    above = pose(0)
    above.t[2] += 14.0
    assert rectify(first, PreparedView(first.camera, above, first.grey), DEPTHS, most=128, overlap=0.2) is None
