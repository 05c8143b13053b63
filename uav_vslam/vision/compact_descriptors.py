# SPDX-License-Identifier: Apache-2.0
"""SIFT descriptors compressed from 128 to 32 bytes: principal components of RootSIFT, quantised to 8 bits.

RootSIFT (the square root of each share of the histogram, [arandjelovic12]) makes Euclidean distances those of the
Hellinger kernel. All components have the same quantisation step, so distances between codes equal those between
descriptors up to quantisation and the omitted components. Codes are offset by 128 into uint8, which `match_descriptors`
compares exactly.

A basis is identified by a number in each packet and never changes once released: `data/descriptor_basis_<number>.npz`
is shipped, made by `scripts/train_descriptors.py`.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import InvalidMessage
from uav_vslam.vision.matching.nn_ratio import SINGLE_CANDIDATE_DISTANCE

RAW = 0  # descriptors as extracted
COMPACT = 1  # trained on rendered and on real ground, see `provenance` in its file
BASES = (COMPACT,)
ZERO_LEVEL = 128
LEVELS = 127  # on either side of zero


@dataclass(frozen=True, slots=True)
class DescriptorBasis:
    """A trained compression.

    Attributes:
        mean: (128,) of RootSIFT.
        components: (K, 128) orthonormal.
        levels_per_unit: quantisation levels per unit; a RootSIFT vector has length one.
        single_distance: `SINGLE_CANDIDATE_DISTANCE` for codes.
        provenance: training data.
    """

    mean: NDArray[np.float32]
    components: NDArray[np.float32]
    levels_per_unit: float
    single_distance: float
    provenance: str

    @property
    def bytes(self) -> int:
        """Length of a code."""
        return len(self.components)

    def compress(self, descriptors: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return (N, K) codes of (N, 128) SIFT descriptors."""
        projected = (root_sift(descriptors) - self.mean) @ self.components.T
        codes = np.clip(np.rint(projected * np.float32(self.levels_per_unit)), -LEVELS, LEVELS)
        return np.asarray(codes + ZERO_LEVEL, np.uint8)


def in_basis(descriptors: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """Convert raw descriptors (N, D) to codes (N, K) of a basis; raw ones stay as they are.

    Raises:
        InvalidMessage: the basis is unknown, or for another descriptor length.
    """
    if number == RAW:
        return descriptors
    basis = load_basis(number)
    if descriptors.shape[1] != len(basis.mean):
        raise InvalidMessage("descriptors", f"basis {number} is not for descriptors of {descriptors.shape[1]} bytes")
    return basis.compress(descriptors)


def single_distance(number: int) -> float:
    """Return the largest distance at which a single candidate is a match."""
    return SINGLE_CANDIDATE_DISTANCE if number == RAW else load_basis(number).single_distance


@cache
def load_basis(number: int) -> DescriptorBasis:
    """Read a shipped basis.

    Raises:
        InvalidMessage: the number is unknown to this release.
    """
    if number not in BASES:
        raise InvalidMessage("descriptors", f"descriptor basis {number} is not known; this release has {BASES}")
    with files("uav_vslam.vision").joinpath(f"data/descriptor_basis_{number}.npz").open("rb") as file:
        data = np.load(file)
        return DescriptorBasis(
            data["mean"],
            data["components"],
            float(data["levels_per_unit"]),
            float(data["single_distance"]),
            str(data["provenance"]),
        )


def root_sift(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (N, D) vectors of length 1: square roots of each entry's share; zeros stay zero."""
    values = descriptors.astype(np.float32)
    return np.asarray(np.sqrt(values / np.maximum(values.sum(axis=1, keepdims=True), 1.0)), np.float32)
