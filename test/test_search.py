# SPDX-License-Identifier: Apache-2.0
"""The nearest of ascending values."""

import numpy as np

from uav_vslam.search import nearest


def test_the_nearest_value_is_found_before_between_and_after_all() -> None:
    others_ns = np.array([10, 20, 40], np.int64)
    stamps_ns = np.array([41, -5, 14, 15, 16, 20, 31], np.int64)  # 15 is as near to 10 as to 20
    assert nearest(stamps_ns, others_ns).tolist() == [2, 0, 0, 0, 1, 1, 2]
    assert nearest(stamps_ns, others_ns[:1]).tolist() == [0] * len(stamps_ns)
