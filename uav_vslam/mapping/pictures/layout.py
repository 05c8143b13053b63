# SPDX-License-Identifier: Apache-2.0
"""Pictures laid out flat: each is scaled, turned and shifted on a plane so that matched points meet.

Scale and turn come first, from ratios and differences between pairs, which cannot shrink the whole as a joint fit of
positions would; then the shifts. Each step is a linear least-squares problem over the graph of pairs, re-weighted
[huber64], so that a false pair loses its influence. In complex numbers, picture i maps its centred pixel p to
z_i p + t_i.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.sparse.linalg import lsqr

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.pairs import MatchedPair

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

REWEIGHTINGS = 12
TURN_SIGMA = 0.03  # of a good pair [rad], and of the logarithm of its scale
SHIFT_SIGMA = 0.03  # of a good pair, as a share of the picture's longest side: what tilt and relief do
FALSE_PAIR = 8.0  # residuals above so many sigmas are of a false pair
EQUALLY_BAD = 0.9  # of the largest residual: a ring spreads its contradiction evenly over its pairs


@dataclass(frozen=True, slots=True)
class Layout:
    """Where pictures lie on the plane, in pixels of the first.

    Attributes:
        used: numbers of the pictures in the largest connected part, ascending.
        turn: (N,) complex scale and rotation of each picture, 0 of those not used.
        shift: (N,) complex position of each picture's centre.
        pairs: those that agree with the layout.
    """

    used: NDArray[np.intp]
    turn: Complex
    shift: Complex
    pairs: tuple[MatchedPair, ...]


def largest_part(count: int, pairs: Sequence[MatchedPair]) -> NDArray[np.intp]:
    """Return the ascending numbers of the pictures in the largest connected part of the graph of pairs."""
    _, label = connected_components(_graph(count, pairs), directed=False)
    sizes = np.bincount(label)
    return np.flatnonzero(label == np.argmax(sizes))


def lay_out(count: int, pairs: Sequence[MatchedPair], centred_px: Sequence[Array], sides_px: Array) -> Layout:
    """Lay pictures out; false pairs are dropped, and what then hangs on nothing else.

    Args:
        count: of pictures.
        pairs: matched ones.
        centred_px: per picture, (M, 2) points measured from its centre [px].
        sides_px: (N,) longest sides.

    Raises:
        PictureError: no pair is left.
    """
    while pairs:
        used = largest_part(count, pairs)
        among = set(used.tolist())
        pairs = [pair for pair in pairs if pair.first in among]
        turn = _turns(count, used, pairs)
        shift, error = _shifts(count, used, pairs, centred_px, turn, float(np.median(sides_px)))
        turn_error = np.array([_turn_error(pair, turn) for pair in pairs]) / TURN_SIGMA
        error = np.maximum(error, turn_error)
        good = error <= max(FALSE_PAIR, 0.5 * float(error.max()))  # the worst first: they mislead others
        if good.all():
            return Layout(used, turn, shift, tuple(pairs))
        pairs = _without_false(count, pairs, good, error)
    raise PictureError("no two pictures fit together; a mosaic needs neighbours that overlap by half or more")


def _without_false(
    count: int, pairs: Sequence[MatchedPair], good: NDArray[np.bool_], error: Array
) -> list[MatchedPair]:
    """Return the good pairs; all but the worst one if the good ones alone would lose pictures.

    Where a ring of pictures contradicts itself and nothing else holds them, all of its pairs look equally bad. Of
    those, the one with the fewest matches goes: without it, the others agree.
    """
    kept = [pair for pair, keep in zip(pairs, good, strict=True) if keep]
    if len(largest_part(count, kept)) == len(largest_part(count, pairs)):
        return kept
    worst = min(np.flatnonzero(error >= EQUALLY_BAD * error.max()).tolist(), key=lambda k: len(pairs[k].rows))
    return [pair for k, pair in enumerate(pairs) if k != worst]


def _graph(count: int, pairs: Sequence[MatchedPair]) -> csr_array:
    """Return the (N, N) upper adjacency whose values are smallest for the pairs with most matches."""
    ends = np.array([(pair.first, pair.second) for pair in pairs], np.intp).reshape(-1, 2)
    cost = np.array([1.0 / len(pair.rows) for pair in pairs])
    return csr_array((cost, (ends[:, 0], ends[:, 1])), shape=(count, count))


def _measured(pair: MatchedPair) -> complex:
    """Return the pair's scale and rotation from the first picture's pixels to the second's."""
    return complex(pair.similarity[0, 0], pair.similarity[1, 0])


def _turn_error(pair: MatchedPair, turn: Complex) -> float:
    """Return the larger of the errors of angle [rad] and log scale of a pair."""
    error = np.log(turn[pair.second] * _measured(pair) / turn[pair.first])
    return float(max(abs(error.real), abs(error.imag)))


def _turns(count: int, used: NDArray[np.intp], pairs: Sequence[MatchedPair]) -> Complex:
    """Return each picture's scale and rotation: along the best tree first, then over all pairs."""
    turn = _along_tree(count, used, pairs)
    for sigma in np.geomspace(np.pi, TURN_SIGMA, REWEIGHTINGS):  # a false pair of the tree has no error at first
        error = np.array([np.log(turn[p.first] / (turn[p.second] * _measured(p))) for p in pairs])
        weight = np.minimum(1.0, sigma / np.maximum(np.abs(error), 1e-12)) * np.sqrt([len(p.rows) for p in pairs])
        step = _differences(count, used, pairs, np.stack([error.real, error.imag], axis=1), weight)
        turn = turn * np.exp(step[:, 0] + 1j * step[:, 1])
    return turn


def _along_tree(count: int, used: NDArray[np.intp], pairs: Sequence[MatchedPair]) -> Complex:
    turn = np.zeros(count, complex)
    measured = {(pair.first, pair.second): _measured(pair) for pair in pairs}
    tree = minimum_spanning_tree(_graph(count, pairs))
    order, parents = breadth_first_order(tree, used[0], directed=False)
    turn[used[0]] = 1.0
    for child in order[1:].tolist():
        parent = int(parents[child])
        turn[child] = (
            turn[parent] * measured[child, parent] if child < parent else turn[parent] / measured[parent, child]
        )
    return turn


def _differences(
    count: int, used: NDArray[np.intp], pairs: Sequence[MatchedPair], values: Array, weight: Array
) -> Array:
    """Return (N, K) x with x[second] - x[first] = (M, K) values in weighted least squares; the first used stays 0."""
    rows = np.arange(len(pairs))
    first, second = (np.array([getattr(pair, end) for pair in pairs], np.intp) for end in ("first", "second"))
    columns = np.full(count, -1)
    columns[used[1:]] = np.arange(len(used) - 1)
    entries = [
        (rows[columns[end] >= 0], columns[end][columns[end] >= 0], sign) for end, sign in ((second, 1), (first, -1))
    ]
    A = sum(
        coo_array((sign * weight[row], (row, column)), shape=(len(pairs), max(1, len(used) - 1))).tocsr()
        for row, column, sign in entries
    )
    x = np.zeros((count, values.shape[1]))
    for k in range(values.shape[1]):
        x[used[1:], k] = lsqr(A, weight * values[:, k], atol=1e-12, btol=1e-12, iter_lim=50 * count)[0][: len(used) - 1]
    return x


def _shifts(
    count: int,
    used: NDArray[np.intp],
    pairs: Sequence[MatchedPair],
    centred_px: Sequence[Array],
    turn: Complex,
    side_px: float,
) -> tuple[Complex, Array]:
    """Return each picture's position, and each pair's error in sigmas."""
    wanted = np.array([_offset(pair, centred_px, turn) for pair in pairs])
    first, second = (np.array([getattr(pair, end) for pair in pairs], np.intp) for end in ("first", "second"))
    sigma = SHIFT_SIGMA * side_px * np.abs(turn[first])
    error = np.zeros(len(pairs))
    shift = np.zeros(count, complex)
    for _ in range(REWEIGHTINGS):
        weight = np.minimum(1.0, 1.0 / np.maximum(error, 1e-12)) / sigma
        x = _differences(count, used, pairs, np.stack([wanted.real, wanted.imag], axis=1), weight)
        shift = x[:, 0] + 1j * x[:, 1]
        error = np.abs(shift[second] - shift[first] - wanted) / sigma
    return shift, error


def _offset(pair: MatchedPair, centred_px: Sequence[Array], turn: Complex) -> complex:
    """Return the position of the second picture minus that of the first, so that matched points meet on average."""
    p, q = centred_px[pair.first][pair.rows[:, 0]], centred_px[pair.second][pair.rows[:, 1]]
    p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
    return complex(turn[pair.first] * complex(*p_mean) - turn[pair.second] * complex(*q_mean))
