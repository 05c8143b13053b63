# SPDX-License-Identifier: Apache-2.0
"""Which tracks to trust: those that pass a gate and, where that is wide, agree with most others.

While the state is uncertain, as at the start, its gate passes nearly anything. A point where the edge of a roof crosses
something on the ground slides as the vehicle moves, though no point of the scene does. Used alone, because its track
was the first to end, or the only one under a wrong calibration, it would make the state certain and wrong, and the gate
would then refuse all good tracks.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.tracks import TrackObservation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WIDE = 25.0  # variance added by the state to a track's residuals, over that of their noise; commonly below 12
# The same where hardly a linearisation holds, as at a start in flight, by metres a second. A few tracks that end first
# would lead off by their noise, though they agree with all others, and those could not be linearised well from there.
FAR_WIDE = 2e4
LEAST_ASKED = 5  # tracks: fewer prove nothing in a wide gate
ROUNDS = 5  # at most: each leaves out what contradicts the tracks kept by the one before


def trusted(
    seen: TrackObservation, others: Callable[[], TrackObservation] | None, P: Array, probability: float
) -> Mask:
    """Return which tracks to use.

    Args:
        seen: T tracks.
        others: makes further ones, seen at the same past poses; called where the gate is wide only.
        P: covariance of the errors of the rig and the past poses.
        probability: of the gate.
    """
    passed, added = seen.gated(P, probability)
    if not passed.any() or (width := np.median(added[passed])) < WIDE:
        return passed
    everyone, possible = seen, passed
    if others is not None:
        more = others()
        everyone, possible = seen.joined(more), np.append(passed, more.gated(P, probability)[0])
    alone = width > FAR_WIDE and passed.sum() < LEAST_ASKED
    if alone or possible.sum() < LEAST_ASKED:
        return np.zeros_like(passed)
    kept = possible
    for _ in range(ROUNDS):
        said = everyone.chosen(kept).of_poses()
        posterior = np.asarray(np.linalg.solve(np.eye(len(P)) + P @ said.Y, P))
        agree, _ = everyone.gated(posterior, probability, mean=posterior @ said.i)
        before, kept = kept, possible & agree
        if (kept == before).all():
            break
    if 2 * kept.sum() <= possible.sum():  # no majority
        return passed
    return kept[: len(passed)]
