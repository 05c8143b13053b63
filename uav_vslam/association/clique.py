# SPDX-License-Identifier: Apache-2.0
"""The largest set of matches that all agree with each other: exact where that is quick, and in bounded time always.

Among right matches nearly all agree, so that most of a large problem is settled by counting: first what disagrees most
is taken away until all agree, and what can't be in a larger set, or is in every largest one, needs no search.
"""

import networkx as nx
import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.intp]
Agreement = NDArray[np.bool_]

SEARCHED = 30  # vertices; beyond it the search, exponential at worst, is left out


def largest_clique(agree: Agreement) -> Rows:
    """Return ascending rows of a maximum clique, or of a maximal one where the search would take too long.

    Args:
        agree: (N, N) symmetric, what its diagonal holds doesn't matter.
    """
    agree = agree | np.eye(len(agree), dtype=bool)
    found = _thinned(agree)
    core = _core(agree, len(found) + 1)
    if len(core) <= len(found):
        return found
    among = agree[np.ix_(core, core)]
    settled = among.all(axis=1)  # they agree with everyone, so a largest clique has them all
    open_ = np.flatnonzero(~settled)
    if len(open_) > SEARCHED:
        return found
    graph = nx.from_numpy_array(among[np.ix_(open_, open_)] & ~np.eye(len(open_), dtype=bool))
    clique, _ = nx.max_weight_clique(graph, weight=None)
    exact = np.sort(np.concatenate([core[settled], core[open_[sorted(clique)]]]))
    return exact if len(exact) > len(found) else found


def _thinned(agree: Agreement) -> Rows:
    """Take away whatever disagrees with most, one after the other, until all agree; then give back what may stay."""
    left = np.arange(len(agree))
    while len(left):
        disagreements = (~agree[np.ix_(left, left)]).sum(axis=1)
        if not disagreements.any():
            break
        left = np.delete(left, np.argmax(disagreements))
    chosen = np.isin(np.arange(len(agree)), left)
    for row in np.flatnonzero(agree[:, chosen].all(axis=1) & ~chosen):  # what went early may agree with all that stayed
        chosen[row] = agree[row, chosen].all()
    return np.flatnonzero(chosen)


def _core(agree: Agreement, size: int) -> Rows:
    """Return what may be in a clique of that size: each agrees with so many that may be in it, itself included."""
    left = np.arange(len(agree))
    while len(left):
        enough = agree[np.ix_(left, left)].sum(axis=1) >= size
        if enough.all():
            break
        left = left[enough]
    return left
