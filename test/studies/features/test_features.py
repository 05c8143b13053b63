# SPDX-License-Identifier: Apache-2.0
"""The study of features: its sets and pairs, its figures where they are known, and what it concludes."""

from pathlib import Path

import numpy as np
import pytest

from uav_vslam.datasets.image_sets import LAYOUTS, files_of, read_image
from uav_vslam.evaluation.study import TABLE
from uav_vslam.studies.features.compute import (
    BANDS,
    PLACES,
    SPACINGS,
    SWEEP_RATIOS,
    THRESHOLDS,
    FeatureLab,
    count_jobs,
    feature_rows,
    nearest,
)
from uav_vslam.studies.features.sets import (
    ImageSet,
    View,
    cross_pairs,
    downscaled,
    rendered_set,
    spaced_pairs,
    static_truth,
)
from uav_vslam.studies.features.sets import usual_pairs as usual
from uav_vslam.studies.features.trends import TRENDS, trend_rows
from uav_vslam.vision.features import Keypoints
from uav_vslam.vision.matching import MATCHERS

SHIFT = np.array([6.0, -4.0])  # of the second image's content [px]


def texture(seed: int) -> np.ndarray:
    rng, image = np.random.default_rng(seed), np.zeros((160, 200))
    for cell in (5, 10, 20):
        image += np.kron(rng.normal(0, 30, (160 // cell, 200 // cell)), np.ones((cell, cell)))
    return np.clip(128 + image, 0, 255).astype(np.uint8)


def make_set(*, bands: int = 1) -> ImageSet:
    """A still camera whose second and third images are shifted; a second band shows something else."""
    views, shifts = {}, {}
    for band in [f"band {k}" for k in range(bands)]:
        whole = texture(len(views))
        parts = whole[10:130, 10:170], whole[14:134, 4:164]
        images = {0: parts[0], 1: parts[1], 2: parts[1]}
        views[band] = {k: View("made", band, k, str(k), image) for k, image in images.items()}
        shifts |= {(band, 0): SHIFT, (band, 1): np.zeros(2), (band, 2): np.zeros(2)}
    return ImageSet("made", views, (1, 2), cross=1 if bands > 1 else None, truth=static_truth(shifts))


def test_pairs_are_those_of_each_band_between_bands_and_at_all_distances() -> None:
    images = make_set(bands=2)
    assert [pair.label for pair in usual(images)] == ["made band 0 0 – 1", "made band 1 0 – 1"]
    assert [pair.label for pair in cross_pairs(images)] == ["made band 0 / band 1 0 – 1", "made band 1 / band 0 0 – 1"]
    assert [pair.spacing for pair in spaced_pairs(images)] == [1, 2, 1, 2]
    assert list(cross_pairs(make_set())) == []


def test_the_truth_of_a_still_camera_is_its_shift() -> None:
    pair = next(usual(make_set()))
    first = np.array([[20.0, 30.0], [40.0, 50.0]])
    np.testing.assert_allclose(pair.errors(first, first + SHIFT + [[0, 0], [3, 4]]), [0.0, 5.0])


def test_the_truth_of_a_rendered_flight_moves_points_along_the_flight() -> None:
    images = rendered_set(1, 640)
    pairs = list(spaced_pairs(images))
    centre = np.array([[320.0, 240.0]])
    ways = [float(pair.errors(centre, centre)[0]) for pair in pairs]
    assert [pair.spacing for pair in pairs] == [1, 2, 5, 10]
    expected_px = 20.0 / 7.14 / 70.0 * 821  # a frame's flight over the height, times the focal length
    np.testing.assert_allclose(ways, np.array([1, 2, 5, 10]) * expected_px, rtol=0.25)  # it also rocks


def test_wide_images_alone_are_shrunk() -> None:
    assert downscaled(np.zeros((60, 80, 3), np.uint8), 40).shape == (30, 40, 3)
    assert downscaled(np.zeros((60, 80), np.uint8), 80).shape == (60, 80)


def test_matching_some_rows_at_a_time_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    a, b = (
        Keypoints(np.zeros((n, 2), np.float32), np.zeros(n, np.float32), rng.integers(0, 9, (n, 8)).astype(np.uint8))
        for n in (25, 40)
    )
    whole = MATCHERS["nn"](a, b, 0.9)
    monkeypatch.setattr("uav_vslam.studies.features.compute.ROWS_AT_ONCE", 7)
    np.testing.assert_array_equal(nearest(a, b, 0.9), whole)
    assert len(whole) > 3


def test_a_shifted_image_gives_right_matches_and_consistent_figures() -> None:
    row = FeatureLab().match("SIFT", next(usual(make_set()))).row
    assert row["matches"] >= row["matches_ransac"] > 20
    assert row["precision_ransac"] == 1.0 >= row["precision"] > 0.9
    assert row["rate_1"] == row["matches"] / row["keypoints_1"]
    assert row["rate_2_ransac"] == row["matches_ransac"] / row["keypoints_2"]
    assert row["extract_s"] > 0


def test_points_on_a_grid_are_right_to_half_its_diagonal() -> None:
    """The shift is no multiple of the grid's step, so no match is exact."""
    row = FeatureLab().match("DSIFT", next(usual(make_set()))).row
    assert row["matches_ransac"] > 20
    assert row["precision_ransac"] > 0.9


def test_every_table_has_a_row_for_each_of_its_pairs_and_algorithms() -> None:
    images, done = make_set(bands=2), []
    rows = feature_rows([images], FeatureLab(), ["SIFT", "DSIFT"], lambda: done.append(1))
    counts = {table: sum(row[TABLE] == table for row in rows) for table in (THRESHOLDS, BANDS, PLACES, SPACINGS)}
    assert counts == {THRESHOLDS: 2 * len(SWEEP_RATIOS), BANDS: 8, PLACES: 4, SPACINGS: 8}
    assert len(done) == len(rows) == count_jobs([images], ["SIFT", "DSIFT"])
    assert {row["spacing"] for row in rows if row[TABLE] == SPACINGS} == {1, 2}


def made_up(table: str, method: str, **figures: float) -> dict[str, object]:
    row = {"condition": "x visible 1 – 2", "camera": "moving", "descriptor_ratio": 0.8, "keypoints_1": 100}
    row |= {"extract_s": 1.0, "match_s": 0.1, "matches": 50, "matches_ransac": 40, "rate_1": 0.5, "rate_1_ransac": 0.4}
    return {TABLE: table, "method": method, **row, "precision": 0.8, "precision_ransac": 1.0, **figures}


def verdict(rows: list[dict[str, object]], start: str) -> str:
    return next(str(row["verdict"]) for row in trend_rows(rows) if str(row["method"]).startswith(start))


def test_trends_agree_with_the_thesiss_own_figures_and_differ_from_opposite_ones() -> None:
    rates = {"ASIFT": (0.44, 76.0), "SURF": (0.34, 0.6), "SIFT": (0.24, 3.6)}  # table 3.6.3, urban
    rows = [made_up(PLACES, m, rate_1=rate, matches=1000 * rate, extract_s=s) for m, (rate, s) in rates.items()]
    swapped = [{**row, "method": {"ASIFT": "SURF", "SURF": "ASIFT"}.get(row["method"], row["method"])} for row in rows]
    for start in ("ASIFT finds", "ASIFT has", "ASIFT takes", "SURF is the fastest"):
        assert verdict(rows, start) == "agrees"
        assert verdict(swapped, start) == "differs"
    assert verdict(rows, "SURF's matching rates") == "agrees"
    assert verdict(rows[1:], "ASIFT") == "not tested"


def test_ransac_is_said_to_help_only_where_precision_rises() -> None:
    rows = [made_up(SPACINGS, "SIFT", spacing=1)]
    assert verdict(rows, "RANSAC removes") == "agrees"
    assert verdict([{**rows[0], "precision_ransac": 0.7}], "RANSAC removes") == "differs"
    assert verdict([{**rows[0], "precision": None, "precision_ransac": None}], "RANSAC removes") == "not tested"


def test_bands_are_said_to_fail_when_no_algorithm_keeps_more_than_chance() -> None:
    row = made_up(BANDS, "SURF", condition="x visible / thermal 1 – 2", matches_ransac=5, rate_1_ransac=0.05)
    assert verdict([row], "matching visible with thermal") == "agrees"
    assert verdict([{**row, "matches_ransac": 40}], "matching visible with thermal") == "differs"
    assert verdict([row], "matching visible with near infrared") == "not tested"


def test_a_bands_rates_are_held_against_the_visible_ones_of_its_own_set() -> None:
    rows = [
        made_up(BANDS, "SIFT", condition=f"camp {band} 1 – 2") for band in ("visible", "thermal", "visible / thermal")
    ]
    rows[1]["rate_1"] = 0.6
    assert verdict(rows, "thermal images match") == "agrees"
    rows[1]["rate_1"] = 0.4
    assert verdict(rows, "thermal images match") == "differs"
    assert verdict(rows, "near infrared images match") == "not tested"


def test_what_a_grid_matches_with_itself_decides_nothing() -> None:
    rows = [made_up(PLACES, "PHOW (RGB)", rate_1_ransac=0.01), made_up(PLACES, "PHOW (RGB)", camera="still")]
    assert verdict(rows, "colour descriptors are poor") == "agrees"
    assert verdict(rows[1:], "colour descriptors are poor") == "not tested"


def test_images_of_one_name_and_number_are_not_taken_for_each_other() -> None:
    lab, sets = FeatureLab(), [make_set(), make_set()]
    sets[1].bands["band 0"][1] = View("made", "band 0", 1, "1", texture(9)[:120, :160])
    alike, unlike = (lab.match("SIFT", next(usual(images))).row for images in sets)
    assert alike["matches_ransac"] > 20 > unlike["matches"]


def test_no_trend_is_concluded_from_sequences_of_which_nothing_matches() -> None:
    figures = {"matches": 0, "matches_ransac": 0, "rate_1": 0.0, "rate_1_ransac": 0.0, "extract_s": 1.0, "match_s": 1.0}
    common = {"camera": "moving", "keypoints_1": 9, "precision": None, "precision_ransac": None, **figures}
    rows = [
        {TABLE: table, "method": method, "condition": f"set 0 – {k}", "descriptor_ratio": ratio, **common}
        for table, ratio in ((THRESHOLDS, 0.55), (THRESHOLDS, 0.95), (PLACES, 0.8), (SPACINGS, 0.8))
        for method in ("ASIFT", "SURF", "SIFT", "DSIFT", "PHOW (RGB)")
        for k in (1, 2)
    ]
    for claim in ("a higher threshold", "ASIFT finds", "ASIFT has", "SURF's matching", "matches grow", "matches in"):
        assert verdict(rows, claim) == "not tested"


def test_every_trend_is_told_even_without_figures() -> None:
    rows = trend_rows([])
    assert len(rows) == 19
    assert {row[TABLE] for row in rows} == {TRENDS}
    assert {row["verdict"] for row in rows} == {"not tested"}


@pytest.mark.data
@pytest.mark.parametrize(
    ("band", "keypoints", "matches"),
    [("visible", (279, 306), [149, 171, 224]), ("thermal", (210, 212), [108, 130, 173])],
)
def test_sift_gives_the_known_counts_on_the_thesiss_images(
    data_root: Path, band: str, keypoints: tuple[int, int], matches: list[int]
) -> None:
    """Keypoints and matches of 1802 and 1810 as OpenCV's own SIFT and brute-force matcher give them."""
    files = files_of(LAYOUTS["tno_nato_camp"], data_root / "tno_nato_camp")[band]
    views = {k: View("camp", band, k, str(k), read_image(files[k])) for k in (0, 4)}
    pair, lab = next(usual(ImageSet("camp", {band: views}, (4,), usual=4))), FeatureLab()
    rows = [lab.match("SIFT", pair, ratio).row for ratio in SWEEP_RATIOS]
    assert {(row["keypoints_1"], row["keypoints_2"]) for row in rows} == {keypoints}
    assert [row["matches"] for row in rows] == matches
