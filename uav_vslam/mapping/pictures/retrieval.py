# SPDX-License-Identifier: Apache-2.0
"""Which pictures look alike: vectors of locally aggregated descriptors, VLAD [jegou10] with intra-normalisation.

Each picture is one vector: per visual word, the sum of the differences between the word and the root-normalised
descriptors nearest to it. It finds pictures of the same ground that are far apart in time.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

Array = NDArray[np.float64]

WORDS = 32
PER_PICTURE = 400  # descriptors of each picture that the vocabulary is made of
LEARNT_FROM = 20_000
ITERATIONS = 12
SEED = 5


def similarity(descriptors: Sequence[NDArray[np.uint8]]) -> Array:
    """Return the (N, N) cosine similarity of pictures by their (Mi, 128) descriptors; 0 where one has none."""
    roots = [_root(each) for each in descriptors]
    sample = np.concatenate([each[:: max(1, len(each) // PER_PICTURE)][:PER_PICTURE] for each in roots])
    if len(sample) < WORDS:
        return np.eye(len(roots))
    rng = np.random.default_rng(SEED)
    sample = sample[rng.permutation(len(sample))[:LEARNT_FROM]]
    words, _ = kmeans2(sample, WORDS, iter=ITERATIONS, minit="points", rng=rng)
    vectors = np.stack([_aggregated(each, words) for each in roots])
    return np.asarray(vectors @ vectors.T)


def _root(descriptors: NDArray[np.uint8]) -> Array:
    """Return descriptors whose Euclidean distance is Hellinger's [arandjelovic12]."""
    values = descriptors.astype(np.float64)
    return np.sqrt(values / np.maximum(values.sum(axis=1, keepdims=True), 1.0))


def _aggregated(descriptors: Array, words: Array) -> Array:
    """Return the (WORDS * D,) unit vector of one picture."""
    nearest = np.argmin((words**2).sum(axis=1) - 2.0 * descriptors @ words.T, axis=1)
    sums = np.zeros_like(words)
    np.add.at(sums, nearest, descriptors - words[nearest])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    return np.asarray(sums.ravel() / max(float(np.linalg.norm(sums)), 1e-12))
