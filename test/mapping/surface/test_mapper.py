# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from rendered_views import ALTITUDE_M, CAMERA, STEP_M, ground, pose, view
from scipy.ndimage import binary_dilation

from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping import overlap as overlap_module
from uav_vslam.mapping.overlap import Overlap
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.surface.mapper import (
    FARTHEST_SEARCHED_M,
    MOST_VIEWS,
    NOT_BELOW,
    SEARCHED_VIEWS,
    SMALL_CELLS,
    SurfaceMapper,
    most_dispensable,
)
from uav_vslam.mapping.surface.settings import SurfaceSettings
from uav_vslam.mapping.view import View
from uav_vslam.simulation.camera_render import CameraRenderer

SETTINGS = SurfaceSettings(scale=1.0)
VIEWS = 14


def mapped(
    views: list[View], *, cell_m: float = 1.0, settings: SurfaceSettings = SETTINGS
) -> tuple[HeightGrid, SurfaceMapper, Overlap]:
    grid, overlap = HeightGrid(cell_m), Overlap()
    mapper = SurfaceMapper(grid, settings)
    for each in views:
        mapper.add_view(each)
        overlap.add(each)
    mapper.finish()
    return grid, mapper, overlap


def errors(grid: HeightGrid, relief_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and sigmas of the cells with a height of their own."""
    window = grid.window(grid.extent)
    x, y = np.meshgrid(window.raster.x, window.raster.y)
    own = np.isfinite(window.height) & ~window.filled
    return (window.height - ground(relief_m).relief.height(x, y))[own], window.sigma[own]


@pytest.fixture(scope="module")
def flight() -> tuple[HeightGrid, SurfaceMapper, Overlap]:
    return mapped([view(k) for k in range(VIEWS)])


def test_a_level_ground_is_recovered() -> None:
    grid, _, _ = mapped([view(k, 0.0) for k in range(8)])
    error, _ = errors(grid, 0.0)
    assert np.median(np.abs(error)) < 0.05
    assert np.percentile(np.abs(error), 95) < 0.3


def test_hills_are_recovered_and_sigma_is_honest(flight: tuple[HeightGrid, SurfaceMapper, Overlap]) -> None:
    error, sigma = errors(flight[0], 2.0)
    assert np.median(np.abs(error)) < 0.05
    normalised = error / sigma
    assert 0.3 < np.mean(np.abs(normalised) < 1.0) / 0.683 < 1.46
    assert np.mean(np.abs(normalised) > 3.0) < 0.02


def test_a_flight_a_few_metres_above_the_ground_is_mapped() -> None:
    """Heights were searched up to 8 m above the ground, beyond the cameras: no pair seemed to look down on it."""
    low_m, step_m = 5.0, 0.25
    renderer = CameraRenderer(CAMERA, ground(0.0), supersample=2)
    views = []
    for k in range(8):
        T_map_cam = Pose(pose(0).R, np.array([k * step_m, 0.0, low_m]))
        views.append(View("uav1", k, CAMERA, T_map_cam, renderer.render(T_map_cam).astype(np.uint8)))
    # Half size: the rendered texture is coarse from so near.
    grid, mapper, _ = mapped(views, cell_m=0.1, settings=SurfaceSettings())
    assert mapper.pairs > 0
    assert mapper.refused[NOT_BELOW] == 0
    error, _ = errors(grid, 0.0)
    assert len(error) > 1000
    assert np.median(np.abs(error)) < 0.02


def test_nearly_all_that_the_views_show_is_mapped(flight: tuple[HeightGrid, SurfaceMapper, Overlap]) -> None:
    grid, _, overlap = flight
    raster, shown = overlap.count(grid)
    known = np.isfinite(grid.height(raster))
    assert known[shown > 1].mean() > 0.95  # one view alone has no depth
    assert known[shown > 2].mean() > 0.98
    assert not (known & ~binary_dilation(shown > 0, np.ones((3, 3)))).any()


def test_banked_views_are_mapped_beside_the_strip() -> None:
    banks = [0.0] * 5 + [15.0] * 2 + [0.0] * 5
    grid, _, overlap = mapped([view(k, 2.0, bank) for k, bank in enumerate(banks)])
    raster, shown = overlap.count(grid)
    known = np.isfinite(grid.height(raster))
    assert known[shown > 1].mean() > 0.9
    error, sigma = errors(grid, 2.0)
    assert np.median(np.abs(error) / sigma) < 1.0


def test_two_vehicles_share_one_grid() -> None:
    own = [view(k) for k in range(6)]
    peer = [view(k, 2.0, 0.0, (0.0, 20.0), "uav2") for k in range(6)]
    grid, mapper, _ = mapped([each for pair in zip(own, peer, strict=True) for each in pair])
    assert mapper.views == {"uav1": 6, "uav2": 6}
    rows = grid.extent.rows
    assert rows > mapped(own)[0].extent.rows + 15
    error, sigma = errors(grid, 2.0)
    assert np.median(np.abs(error) / sigma) < 1.0


def test_equal_views_give_equal_bits() -> None:
    views = [view(k) for k in range(6)]
    one, other = mapped(views)[0], mapped(views)[0]
    assert np.array_equal(one.height(one.extent), other.height(other.extent), equal_nan=True)


def test_views_without_motion_or_texture_map_nothing() -> None:
    still = [view(0)] * 6
    assert mapped(still)[1].pairs == 0
    blank = [View("uav1", k, view(k).camera, view(k).T_map_cam, np.full((360, 480), 90, np.uint8)) for k in range(6)]
    assert mapped(blank)[0].extent.rows == 0
    assert mapped([])[1].pairs == 0


@pytest.mark.slow
def test_a_slow_flight_is_mapped_like_a_fast_one() -> None:
    """Of 10 cm from frame to frame: `MOST_VIEWS` in a row are less than half a baseline long."""
    mapper = SurfaceMapper(HeightGrid(1.0), SETTINGS)
    for k in range(170):
        mapper.add_view(view(k, origin=(k * (0.1 - STEP_M), 0.0)))
    assert mapper.pairs >= 1
    (lane,) = mapper._lanes.values()
    assert len(lane.views) <= MOST_VIEWS
    error, sigma = errors(mapper.grid, 2.0)
    assert np.median(np.abs(error) / sigma) < 1.0


def test_while_the_ground_is_searched_views_of_all_distances_are_kept() -> None:
    positions: list[float] = []
    for new in np.arange(0.0, 30.0, 0.05):
        if len(positions) >= SEARCHED_VIEWS:
            del positions[most_dispensable([new - old for old in positions])]
        positions.append(new)
        distances = new - np.array(positions[:-1])
        for wanted in (0.5, 1.0, 2.0, 5.0, 10.0):
            assert wanted > new or np.abs(np.log2(distances[distances > 0.0] / wanted)).min() < 1.0, (new, wanted)


def test_views_farther_than_any_baseline_are_given_up_first() -> None:
    assert most_dispensable([FARTHEST_SEARCHED_M + 1.0, 9.0, 8.0, 1.0]) == 0
    assert most_dispensable([0.0, 0.0, 0.0]) > 0


def test_cells_smaller_than_pixels_are_refused_with_the_size_that_suits() -> None:
    mapper = SurfaceMapper(HeightGrid(0.1), SETTINGS)
    for k in range(6):
        mapper.add_view(view(k))
    assert mapper.pairs == 0
    assert mapper.refused[SMALL_CELLS] > 0
    assert mapper.least_cell_m == pytest.approx(2.0 * ALTITUDE_M / view(0).camera.fx, rel=0.05)


def test_a_hovering_vehicle_keeps_few_views() -> None:
    mapper = SurfaceMapper(HeightGrid(1.0), SETTINGS)
    for k in range(5):
        mapper.add_view(view(k))
    pairs = mapper.pairs
    for _ in range(MOST_VIEWS + 6):
        mapper.add_view(view(4))
    assert mapper.pairs == pairs
    (lane,) = mapper._lanes.values()
    assert len(lane.views) < 10  # it is nearly where it was


def test_colour_is_mapped_like_its_grey() -> None:
    views = [view(k) for k in range(6)]
    colour = [View(v.vehicle, v.stamp_ns, v.camera, v.T_map_cam, np.dstack([v.image] * 3)) for v in views]
    one, other = mapped(views)[0], mapped(colour)[0]
    assert np.array_equal(one.height(one.extent), other.height(other.extent), equal_nan=True)


def test_the_footprint_count_is_that_of_the_geometry() -> None:
    grid, _, overlap = mapped([view(k, 0.0) for k in range(6)])
    _, count = overlap.count(grid)
    camera = view(0).camera
    area = (camera.width / camera.fx) * (camera.height / camera.fy) * ALTITUDE_M**2
    assert count.sum() == pytest.approx(6 * area, rel=0.03)
    assert count.max() == 6
    assert overlap.gsd_m(float(np.nanmedian(grid.height(grid.extent)))) == pytest.approx(
        ALTITUDE_M / camera.fx, rel=0.01
    )


def test_a_cell_that_is_seen_ever_again_does_not_start_from_zero(
    flight: tuple[HeightGrid, SurfaceMapper, Overlap], monkeypatch: pytest.MonkeyPatch
) -> None:
    grid, _, overlap = flight
    _, full = overlap.count(grid)
    monkeypatch.setattr(overlap_module, "MOST_VIEWS", 3)
    np.testing.assert_array_equal(overlap.count(grid)[1], np.minimum(full, 3))
