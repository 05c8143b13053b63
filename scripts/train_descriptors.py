#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
r"""Train a basis for compact descriptors, see uav_vslam/vision/compact_descriptors.py.

The shipped basis 1 was made by

    scripts/train_descriptors.py descriptor_basis_1.npz --rendered 4 --images DATA/odm_seneca DATA/odm_garfield \
        --provenance "..."

from SIFT of rendered flights over synthetic grass and of aerial images by OpenDroneMap (CC0): ploughed fields and
roads, grass and wood. Its `provenance` says the same. A basis that has been released never changes: packets name it
by its number, so a new one gets the next number.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.vision.compact_descriptors import LEVELS, DescriptorBasis, root_sift
from uav_vslam.vision.features import make_extractor
from uav_vslam.vision.images import shrink, to_grey8
from uav_vslam.vision.matching.nn_ratio import SINGLE_CANDIDATE_DISTANCE

COMPONENTS = 32
CLIPPED_SHARE = 1e-3  # of the first component's values in training; sets the quantisation step
WIDTH_PX = 1280  # of a camera image; larger ones are downscaled to it before the front end's own scaling
FRAMES_APART = 20  # of a rendered flight, so that each shows new ground
SUFFIXES = {".jpg", ".jpeg", ".png", ".tif"}


def main() -> None:
    """Train and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path, help="descriptor_basis_<number>.npz")
    parser.add_argument("--images", type=Path, nargs="*", default=[], help="folders of images")
    parser.add_argument("--rendered", type=int, default=0, help="flights to render as well (default 0)")
    parser.add_argument("--provenance", required=True, help="what the images are, with their licence")
    args = parser.parse_args()
    extractor = make_extractor(FrontendConfig())
    descriptors = np.concatenate(
        [extractor.detect(image).descriptors for image in images(args.images, args.rendered)], dtype=np.uint8
    )
    basis = train_basis(descriptors, components=COMPONENTS, provenance=args.provenance)
    np.savez_compressed(
        args.output,
        mean=basis.mean,
        components=basis.components,
        levels_per_unit=basis.levels_per_unit,
        single_distance=basis.single_distance,
        provenance=basis.provenance,
    )
    print(f"{len(descriptors)} descriptors; {args.output}: {args.output.stat().st_size} bytes")


def images(folders: list[Path], rendered: int) -> Iterator[np.ndarray]:
    """Yield grey images as passed to the extractor."""
    scale = FrontendConfig().scale
    for path in sorted(p for folder in folders for p in folder.iterdir() if p.suffix.lower() in SUFFIXES):
        image = to_grey8(cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR))
        yield shrink(image, min(1.0, WIDTH_PX / image.shape[1]) * scale)
    for seed in range(1, rendered + 1):
        vehicle = simulate_vehicle(Scenario(seed=1000 + seed, vehicles=1, frames=4 * FRAMES_APART), 0)
        flight = RenderedFlight(vehicle)
        for frame in range(0, 4 * FRAMES_APART, FRAMES_APART):
            yield shrink(to_grey8(flight.frame(frame).left), scale)


def train_basis(descriptors: NDArray[np.uint8], *, components: int, provenance: str) -> DescriptorBasis:
    """Return the principal components of (N, 128) descriptors."""
    vectors = root_sift(descriptors).astype(float)
    mean = vectors.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(vectors.T))
    kept = axes[:, ::-1][:, :components].T
    kept *= np.sign(kept[np.arange(components), np.abs(kept).argmax(axis=1)])[:, None]  # fixes the arbitrary sign
    projected = (vectors - mean) @ kept.T
    levels = LEVELS / float(np.quantile(np.abs(projected[:, 0]), 1.0 - CLIPPED_SHARE))
    reach = _typical_distance(projected * levels) / _typical_distance(descriptors.astype(float))
    return DescriptorBasis(
        mean.astype(np.float32),
        kept.astype(np.float32),
        levels,
        SINGLE_CANDIDATE_DISTANCE * reach,
        provenance,
    )


def _typical_distance(vectors: NDArray[np.float64]) -> float:
    """Return the median distance between random pairs."""
    order = np.random.default_rng(0).permutation(len(vectors))
    return float(np.median(np.linalg.norm(np.diff(vectors[order], axis=0), axis=1)))


if __name__ == "__main__":
    main()
