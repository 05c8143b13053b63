# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest

from uav_vslam.studies.features.match_picture import MOST_LINES, match_picture, save_match_picture
from uav_vslam.studies.features.plot import draw_features, places_plot, spacing_plot, threshold_plot

PLACES = [
    {
        "table": "Places (a)",
        "method": method,
        "condition": f"set {k} 0 – 1",
        "matches": 100 * k,
        "matches_ransac": 50 * k,
    }
    for k in range(4)
    for method in ("SIFT", "SURF")
]
SPACINGS = [
    {"table": "Spacing (b)", "method": method, "condition": f"set {k} 0 – {n}", "spacing": n, "rate_1_ransac": 0.5 / n}
    for k in range(2)
    for method in ("SIFT", "SURF")
    for n in (1, 2, 5)
]
RATIOS = [
    {
        "table": "Thresholds (c)",
        "method": "SIFT",
        "condition": "set",
        "descriptor_ratio": ratio,
        "matches": 9,
        "matches_ransac": 8,
    }
    for ratio in (0.55, 0.95)
]


@pytest.mark.slow
def test_each_table_is_drawn_if_it_has_rows(tmp_path: Path) -> None:
    drawn = draw_features({"rows": [*PLACES, *SPACINGS, *RATIOS]}, tmp_path)
    assert {path.name for path in drawn} == {"places.png", "spacing.png", "thresholds.png"}
    assert all(path.stat().st_size > 5000 for path in drawn)
    assert draw_features({"rows": []}, tmp_path) == []


def test_every_pair_has_a_panel_and_every_algorithm_a_bar_also_without_matches() -> None:
    panels = [axes for axes in places_plot(PLACES).axes if axes.axison]
    assert [axes.get_title() for axes in panels] == [f"set {k} 0 – 1" for k in range(4)]
    assert all(len(axes.patches) == 4 for axes in panels)


def test_curves_run_over_spacing_and_ratio() -> None:
    panels = spacing_plot(SPACINGS).axes
    assert [axes.get_title() for axes in panels] == ["set 0 0 …", "set 1 0 …"]
    assert [list(line.get_xdata()) for line in panels[0].lines] == [[1, 2, 5]] * 2
    assert [list(line.get_ydata()) for line in threshold_plot(RATIOS).axes[0].lines] == [[9, 9], [8, 8]]


def test_a_match_picture_shows_all_matches_above_and_the_kept_ones_below(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0, 50, (30, 2)), rng.uniform(0, 50, (30, 2))
    kept = np.arange(30) < 12
    images = np.zeros((60, 80), np.uint8), np.full((50, 70, 3), 40_000, np.uint16)
    figure = match_picture(images, pixels, kept, "SIFT")
    above, below = figure.axes
    assert (len(above.collections[0].get_segments()), len(below.collections[0].get_segments())) == (30, 12)
    np.testing.assert_allclose(above.collections[0].get_segments()[3][1], pixels[1][3] + [84, 0])
    assert save_match_picture(tmp_path / "new" / "a.png", figure).stat().st_size > 2000


def test_a_match_picture_without_matches_or_with_many_is_drawn_too() -> None:
    image = np.zeros((60, 80), np.uint8)
    many = np.ones((3 * MOST_LINES, 2))
    for pixels in (np.zeros((0, 2)), many):
        figure = match_picture((image, image), (pixels, pixels), np.ones(len(pixels), bool), "SIFT")
        assert len(figure.axes[0].collections[0].get_segments()) == min(len(pixels), MOST_LINES)
