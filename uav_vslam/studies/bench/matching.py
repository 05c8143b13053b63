# SPDX-License-Identifier: Apache-2.0
"""How long graph transformation and dominating sets take, beside the matching of descriptors of as many keypoints."""

from collections.abc import Iterator

import numpy as np

from uav_vslam.evaluation.study import Row
from uav_vslam.studies.bench.stages import row, take_turns
from uav_vslam.vision.matching import match_descriptors
from uav_vslam.vision.matching.cds import dominating_points
from uav_vslam.vision.matching.gtm import same_neighbours

IMAGE_PX = (1280.0, 960.0)
WRONG_SHARE = 0.3  # of the matches
DESCRIPTOR_LENGTH = 128


def graph_matching(keypoints: int, repeats: int) -> Iterator[Row]:
    """Time both graph methods; a third of the matches given to graph transformation is wrong.

    Args:
        keypoints: of each image, all of them matched.
        repeats: of each.
    """
    rng = np.random.default_rng(1)
    a = rng.uniform(0.0, IMAGE_PX, (keypoints, 2))
    b = 1.1 * a + 5.0 * np.sin(a[:, ::-1] / 200.0)  # a smooth deformation
    wrong = rng.choice(keypoints, round(WRONG_SHARE * keypoints), replace=False)
    b[wrong] = rng.uniform(0.0, IMAGE_PX, (len(wrong), 2))
    descriptors = rng.integers(0, 256, (keypoints, DESCRIPTOR_LENGTH), np.uint8)
    works = {
        "graph transformation": (f"{keypoints} matches, {WRONG_SHARE:.0%} wrong", lambda: same_neighbours(a, b)),
        "dominating set": (f"{keypoints} keypoints", lambda: dominating_points(a)),
    }
    for method, (condition, work) in works.items():
        ms, ratio = take_turns([work] * repeats, lambda: match_descriptors(descriptors, descriptors, 0.8))
        yield row(method, condition, "matching their descriptors", ratio, ms_per_frame=ms)
