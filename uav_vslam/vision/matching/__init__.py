# SPDX-License-Identifier: Apache-2.0
"""Descriptor matchers by name: each takes (a, b, ratio, mutual=...) and returns (M, 2) indices."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from uav_vslam.vision.matching.nn_ratio import match_descriptors, match_gated

__all__ = ["MATCHERS", "Matcher", "match_descriptors", "match_gated"]


class Matcher(Protocol):
    """Matches the rows of two descriptor sets."""

    def __call__(
        self, a: NDArray[np.generic], b: NDArray[np.generic], ratio: float, *, mutual: bool = True
    ) -> NDArray[np.intp]:
        """Return (M, 2) indices into `a` and `b`; 0 rows on either side give 0 matches."""
        ...


MATCHERS: dict[str, Matcher] = {"nn_ratio": match_descriptors}
