# SPDX-License-Identifier: Apache-2.0
"""Maximum clique of mutually consistent matches: exact for small problems, always in bounded time.

Nearly all correct matches agree, so degrees settle most of a large problem: a greedy clique is found by removing the
vertices with most disagreements; only vertices that may be in a larger clique, but not in all, are searched.
"""

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.intp]
Agreement = NDArray[np.bool_]

SEARCHED = 30  # vertices; larger problems skip the search, which is exponential at worst


def largest_clique(agree: Agreement) -> Rows:
    """Return ascending rows of a maximum clique, or of a maximal one if the search would take too long.

    Args:
        agree: (N, N) symmetric; the diagonal is ignored.
    """
    agree = agree | np.eye(len(agree), dtype=bool)
    found = _greedy_clique(agree)
    core = _core(agree, len(found) + 1)
    if len(core) <= len(found):
        return found
    among = agree[np.ix_(core, core)]
    settled = among.all(axis=1)  # they agree with all, so are in every maximum clique
    open_ = np.flatnonzero(~settled)
    if len(open_) > SEARCHED:
        return found
    import networkx as nx  # takes a second to load, and most problems are settled before

    graph = nx.from_numpy_array(among[np.ix_(open_, open_)] & ~np.eye(len(open_), dtype=bool))
    clique, _ = nx.max_weight_clique(graph, weight=None)
    exact = np.sort(np.concatenate([core[settled], core[open_[sorted(clique)]]]))
    return exact if len(exact) > len(found) else found


def _greedy_clique(agree: Agreement) -> Rows:
    """Remove the vertex with most disagreements until all agree; then re-add those that fit."""
    left = np.arange(len(agree))
    while len(left):
        disagreements = (~agree[np.ix_(left, left)]).sum(axis=1)
        if not disagreements.any():
            break
        left = np.delete(left, np.argmax(disagreements))
    chosen = np.isin(np.arange(len(agree)), left)
    for row in np.flatnonzero(agree[:, chosen].all(axis=1) & ~chosen):  # early removals may fit the remaining set
        chosen[row] = agree[row, chosen].all()
    return np.flatnonzero(chosen)


def _core(agree: Agreement, size: int) -> Rows:
    """Return the vertices that may be in a clique of that size (k-core): each agrees with that many, itself too."""
    left = np.arange(len(agree))
    while len(left):
        enough = agree[np.ix_(left, left)].sum(axis=1) >= size
        if enough.all():
            break
        left = left[enough]
    return left
