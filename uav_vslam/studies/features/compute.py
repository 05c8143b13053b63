# SPDX-License-Identifier: Apache-2.0
"""Extractors compared on image pairs: points, matches with and without RANSAC, and time, section 3.6 of [thesis].

As there, each extractor has the parameters of its authors, a match is the nearest descriptor that passes the ratio test
(not checked from the other side), and RANSAC fits a homography.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from time import process_time

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.studies.features.sets import ImageSet, Pair, View, cross_pairs, spaced_pairs, usual_pairs
from uav_vslam.vision.features import Extractor, Keypoints
from uav_vslam.vision.features.asift import AffineSiftExtractor
from uav_vslam.vision.features.dense import DenseSiftExtractor
from uav_vslam.vision.features.orb import OrbExtractor
from uav_vslam.vision.features.phow import PhowExtractor
from uav_vslam.vision.features.sift import SiftExtractor
from uav_vslam.vision.features.surf import SurfExtractor
from uav_vslam.vision.matching import MATCHERS
from uav_vslam.vision.matching.ransac import same_homography

LOWE_RATIO = 0.8
SWEEP_RATIOS = (0.55, 0.75, 0.95)
CORRECT_PX = 3.0
ROWS_AT_ONCE = 1000  # of the first image: 60 000 points of either would need 14 GB
EVERY_POINT = 1_000_000
THESIS_DENSE, THESIS_PHOW = 1715, 6909  # points an image in table 3.6.3
OPENCV_SIFT = FrontendConfig(contrast_threshold=0.04, max_features=EVERY_POINT)

THRESHOLDS = "Thresholds (table 3.6.1)"
BANDS = "Bands (table 3.6.2)"
PLACES = "Places (table 3.6.3)"
SPACINGS = "Spacing (table 3.6.4)"

ALGORITHMS: dict[str, Callable[[], Extractor]] = {
    "ASIFT": lambda: AffineSiftExtractor(OPENCV_SIFT, precise=False),
    "SURF": lambda: SurfExtractor(FrontendConfig(max_features=EVERY_POINT)),
    "SIFT": lambda: SiftExtractor(OPENCV_SIFT, precise=False),
    "DSIFT": lambda: DenseSiftExtractor(FrontendConfig(max_features=THESIS_DENSE)),
    "PHOW (RGB)": lambda: PhowExtractor(FrontendConfig(max_features=THESIS_PHOW), "rgb"),
    "PHOW (HSV)": lambda: PhowExtractor(FrontendConfig(max_features=THESIS_PHOW), "hsv"),
    "PHOW (opponent)": lambda: PhowExtractor(FrontendConfig(max_features=THESIS_PHOW), "opponent"),
    "ORB": lambda: OrbExtractor(FrontendConfig(max_features=2000)),
}
ON_A_GRID = {"DSIFT", "PHOW (RGB)", "PHOW (HSV)", "PHOW (opponent)"}
SWEPT = ("SIFT", "SURF")  # table 3.6.1 has these

NOTES = {
    "Parameters": "each algorithm's own: SIFT and ASIFT with OpenCV's defaults (contrast 0.04), SURF with OpenSURF's "
    f"threshold, at most {THESIS_DENSE} points of dense SIFT and {THESIS_PHOW} of PHOW, as in the thesis; ORB, which "
    "the thesis hasn't, 2000",
    "Matches": f"nearest descriptor with ratio test ({LOWE_RATIO} but where ratios are compared), not checked from the "
    "other side; RANSAC fits a homography to 3 px; rates are matches over the keypoints of the first and second image",
    "Precision": f"matches within {CORRECT_PX:.0f} px of the truth, for points on a grid half its diagonal more, which "
    "is known where the camera stands still or the flight is rendered",
    "Still cameras": "show a point of a grid where it was: dense SIFT and PHOW match the grid with itself, and such "
    "rows don't count where the thesis's conclusions are tested",
    "Times": "CPU seconds of one thread: both images' extraction, matching, and RANSAC besides; SURF searches an image "
    "with a border of 96 px all round, at a width of 360 px 2.6 times as large: without it points near the border, "
    "three quarters of them there, would be lost",
}


@dataclass(frozen=True, slots=True)
class Matched:
    """The matches of one pair by one algorithm.

    Attributes:
        row: their figures.
        first, second: (M, 2) pixels.
        kept: (M,) which of them RANSAC keeps.
    """

    row: Row
    first: NDArray[np.float32]
    second: NDArray[np.float32]
    kept: NDArray[np.bool_]


@dataclass
class FeatureLab:
    """Extracts and matches each image and pair once."""

    _found: dict[tuple[str, View], tuple[Keypoints, float]] = field(default_factory=dict)
    _matched: dict[tuple[str, View, View, float], Matched] = field(default_factory=dict)

    def match(self, method: str, pair: Pair, ratio: float = LOWE_RATIO) -> Matched:
        """Return the matches of a pair."""
        key = method, pair.first, pair.second, ratio
        if key not in self._matched:
            self._matched[key] = self._measure(method, pair, ratio)
        return self._matched[key]

    def _extract(self, method: str, view: View) -> tuple[Keypoints, float]:
        """Return the keypoints of an image and how long they took [s]."""
        key = method, view
        if key not in self._found:
            extractor, start = ALGORITHMS[method](), process_time()
            keypoints = extractor.detect(view.image)
            self._found[key] = keypoints, process_time() - start
        return self._found[key]

    def _measure(self, method: str, pair: Pair, ratio: float) -> Matched:
        (a, seconds_a), (b, seconds_b) = (self._extract(method, view) for view in (pair.first, pair.second))
        start = process_time()
        pairs = nearest(a, b, ratio)
        match_s, start = process_time() - start, process_time()
        first, second = a.pixels[pairs[:, 0]], b.pixels[pairs[:, 1]]
        kept = np.isin(np.arange(len(pairs)), same_homography(first, second))
        ransac_s = process_time() - start
        errors = pair.errors(first, second)
        right = None if errors is None else errors < CORRECT_PX + _half_diagonal(method, a)
        row: Row = {
            "method": method,
            "condition": pair.label,
            "camera": "still" if pair.images.still else "moving",
            "descriptor_ratio": ratio,
            "keypoints_1": len(a),
            "keypoints_2": len(b),
            "extract_s": seconds_a + seconds_b,
            "match_s": match_s,
            "ransac_s": ransac_s,
            "matches": len(pairs),
            "matches_ransac": int(kept.sum()),
            "rate_1": _share(len(pairs), len(a)),
            "rate_2": _share(len(pairs), len(b)),
            "rate_1_ransac": _share(kept.sum(), len(a)),
            "rate_2_ransac": _share(kept.sum(), len(b)),
            "precision": None if right is None else _share(right.sum(), len(right)),
            "precision_ransac": None if right is None else _share(right[kept].sum(), kept.sum()),
        }
        return Matched(row, first, second, kept)


def nearest(a: Keypoints, b: Keypoints, ratio: float) -> NDArray[np.intp]:
    """Return `MATCHERS["nn"]` of two images, some rows at a time: a row's match doesn't depend on the other rows."""
    parts = [np.zeros((0, 2), np.intp)]
    for start in range(0, len(a), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        part = MATCHERS["nn"](Keypoints(a.pixels[rows], a.responses[rows], a.descriptors[rows]), b, ratio)
        parts.append(part + np.array([start, 0]))
    return np.concatenate(parts)


def count_jobs(sets: Iterable[ImageSet], methods: Sequence[str]) -> int:
    """Return how often `feature_rows` calls `on_job`."""
    return sum(1 for images in sets for _ in _jobs(images, methods))


def feature_rows(
    sets: Iterable[ImageSet], lab: FeatureLab, methods: Sequence[str], on_job: Callable[[], None] = lambda: None
) -> list[Row]:
    """Return the rows of all tables.

    Args:
        sets: images.
        lab: what extracts and matches them.
        methods: names in ALGORITHMS.
        on_job: called after each pair of each algorithm in each table.
    """
    rows: list[Row] = []
    for images in sets:
        for table, pair, method, ratio in _jobs(images, methods):
            row = {TABLE: table, **lab.match(method, pair, ratio).row}
            rows.append({**row, "spacing": pair.spacing} if table == SPACINGS else row)
            on_job()
    order = [THRESHOLDS, BANDS, PLACES, SPACINGS]
    return sorted(rows, key=lambda row: order.index(row[TABLE]))


def _jobs(images: ImageSet, methods: Sequence[str]) -> Iterable[tuple[str, Pair, str, float]]:
    """Yield table, pair, algorithm and ratio of every row that a set gives."""
    usual, cross = list(usual_pairs(images)), list(cross_pairs(images))
    for pair in usual:
        for method in (method for method in methods if method in SWEPT):
            yield from ((THRESHOLDS, pair, method, ratio) for ratio in SWEEP_RATIOS)
    for table, pairs in (
        (BANDS, usual + cross if cross else []),
        (PLACES, usual),
        (SPACINGS, list(spaced_pairs(images))),
    ):
        yield from ((table, pair, method, LOWE_RATIO) for pair in pairs for method in methods)


def _half_diagonal(method: str, keypoints: Keypoints) -> float:
    """Return how far a point may be from the nearest of a grid, 0 for detected points [px]."""
    if method not in ON_A_GRID or len(keypoints) < 2:
        return 0.0
    columns = np.unique(keypoints.pixels[:, 0])
    return float(np.diff(columns).min(initial=np.inf)) / 2.0**0.5 if len(columns) > 1 else 0.0


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole else float("nan")
