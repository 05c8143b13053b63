# SPDX-License-Identifier: Apache-2.0
"""The nearest of ascending values, and the rows of given ones."""

import numpy as np

from uav_vslam.search import nearest, rows_of


def test_the_nearest_value_is_found_before_between_and_after_all() -> None:
    others_ns = np.array([10, 20, 40], np.int64)
    stamps_ns = np.array([41, -5, 14, 15, 16, 20, 31], np.int64)  # 15 is as near to 10 as to 20
    assert nearest(stamps_ns, others_ns).tolist() == [2, 0, 0, 0, 1, 1, 2]
    assert nearest(stamps_ns, others_ns[:1]).tolist() == [0] * len(stamps_ns)


def test_values_are_found_in_an_array_in_any_order() -> None:
    ids = np.array([7, 2, 9, 4], np.uint32)
    assert rows_of(ids[[3, 0, 2]], ids).tolist() == [3, 0, 2]
    assert rows_of(ids[:0], ids).tolist() == rows_of(ids[:0], ids[:0]).tolist() == []
