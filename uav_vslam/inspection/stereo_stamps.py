# SPDX-License-Identifier: Apache-2.0
"""How far apart left and right images are stamped, and how many make pairs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.stereo_sync import NOTABLE_OFFSET_NS, PairTolerance, nearest_offsets_ns
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning
from uav_vslam.types import NS_PER_S

Stamps = NDArray[np.int64]

BINS = 15


@dataclass(frozen=True, slots=True)
class OffsetHistogram:
    """Stamps of right images minus those of the nearest left ones.

    Attributes:
        edges_s: (BINS + 1,) [s].
        counts: (BINS,).
        median_s: [s].
        spread_s: from the 16th to the 84th percentile [s].
    """

    edges_s: tuple[float, ...]
    counts: tuple[int, ...]
    median_s: float
    spread_s: float


def histogram(left_ns: Stamps, right_ns: Stamps) -> OffsetHistogram | None:
    """Return the histogram for (N,) left and (M,) right stamps [ns]; None without any of either."""
    offsets = nearest_offsets_ns(left_ns, right_ns)
    if len(offsets) == 0:
        return None
    seconds = offsets / NS_PER_S
    counts, edges = np.histogram(seconds, BINS)
    low, median, high = np.percentile(seconds, (16, 50, 84))
    return OffsetHistogram(tuple(edges.tolist()), tuple(counts.tolist()), float(median), float(high - low))


def check_pairs(left_ns: Stamps, right_ns: Stamps, pair_count: int, *, tolerance_s: float) -> list[Finding]:
    """Check that images make pairs.

    Args:
        left_ns, right_ns: (N,), (M,) stamps [ns].
        pair_count: pairs that the graph makes of them.
        tolerance_s: the setting `input.pair_tolerance_s`; 0 for the default.
    """
    shape = histogram(left_ns, right_ns)
    if shape is None:
        return []
    tolerance = PairTolerance(round(tolerance_s * NS_PER_S))
    for stamp_ns in left_ns.tolist():
        tolerance.add_left(stamp_ns)
    tolerance_ms = tolerance.ns / 1e6
    seen = (
        f"right minus left stamp: median {1e3 * shape.median_s:.3g} ms, spread {1e3 * shape.spread_s:.2g} ms; "
        f"{pair_count} of {len(left_ns)} left and of {len(right_ns)} right images find a partner"
    )
    allowed = f"{tolerance_ms:.3g} ms (input.pair_tolerance_s)"
    steps_ns = np.diff(np.unique(left_ns))
    period_s = float(np.median(steps_ns)) / NS_PER_S if len(steps_ns) else limits.OWN_CLOCK_S
    most = max(len(left_ns), len(right_ns))
    if most - pair_count > max(1.0, limits.UNPAIRED_SHARE * most):
        judge = error if pair_count < limits.UNUSABLE_SHARE * len(left_ns) else warning
        repeated = len(steps_ns) + 1 < limits.UNUSABLE_SHARE * len(left_ns)  # `timing.check_order` says so
        remedy = "give each image a stamp of its own" if repeated else _remedy(shape, tolerance_ms, period_s)
        return [judge("stereo stamps", seen, allowed, remedy)]
    if abs(shape.median_s) * NS_PER_S > NOTABLE_OFFSET_NS:
        remedy = "they count as simultaneous, which is right for triggered cameras only: else synchronise the cameras"
        return [warning("stereo stamps", seen, f"{NOTABLE_OFFSET_NS / 1e6:g} ms for exact pairs", remedy)]
    return [ok("stereo stamps", seen)]


def _remedy(shape: OffsetHistogram, tolerance_ms: float, period_s: float) -> str:
    if abs(shape.median_s) > min(period_s, limits.OWN_CLOCK_S):  # no right image is of the time of the left ones
        return "the cameras' clocks differ, or they were recorded one after the other: stamp both with one clock"
    offset_ms = 1e3 * abs(shape.median_s)
    if offset_ms > tolerance_ms and 1e3 * shape.spread_s < 0.1 * offset_ms:
        wider = f"{1.2 * abs(shape.median_s):.3g}"
        return f"if one trigger exposes both, set input.pair_tolerance_s: {wider}; else synchronise the cameras"
    return "synchronise the cameras, or look for images that were not recorded"
