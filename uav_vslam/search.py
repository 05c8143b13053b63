# SPDX-License-Identifier: Apache-2.0
"""Search in arrays; apart from `numerics`, which brings SciPy, a third of the start of a node without."""

import numpy as np
from numpy.typing import NDArray


def nearest(values: NDArray[np.number], others: NDArray[np.number]) -> NDArray[np.intp]:
    """Return the index of the other value nearest to each value, as of stamps; of two as near, that of the smaller.

    Args:
        values: (N,) in any order.
        others: (M,) ascending, at least one.
    """
    after = np.searchsorted(others, values).clip(0, len(others) - 1)
    before = (after - 1).clip(0)
    nearer = np.abs(others[before] - values) <= np.abs(others[after] - values)
    return np.asarray(np.where(nearer, before, after))


def rows_of(wanted: NDArray[np.number], among: NDArray[np.number]) -> NDArray[np.intp]:
    """Return the (N,) rows of values, as of identifiers, in an array (M,) in any order that holds each of them once."""
    order = np.argsort(among)
    return np.asarray(order[np.searchsorted(among, wanted, sorter=order)])
