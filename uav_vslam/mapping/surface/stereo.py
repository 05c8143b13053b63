# SPDX-License-Identifier: Apache-2.0
"""Dense matching of a rectified pair: semi-global matching [hirschmuller08] by OpenCV."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.mapping.surface.prepared import Grey
from uav_vslam.mapping.surface.rectification import BLOCK_PX, RectifiedPair
from uav_vslam.mapping.surface.settings import SurfaceSettings

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

SMALL_STEP, LARGE_STEP = 8 * BLOCK_PX**2, 32 * BLOCK_PX**2  # penalties of a change of the disparity by one and by more
LEFT_RIGHT_PX = 1
UNIQUENESS = 5  # per cent by which the best cost is below the second best
PREFILTER = 31
SPECKLE_PX, SPECKLE_RANGE = 60, 1
BORDER = np.ones((BLOCK_PX, BLOCK_PX), np.uint8)  # blocks over the edge of an image match its outline
REFINED_PX = 7  # side of the block of the least-squares step
LARGEST_STEP_PX = 0.75
UNLIKE = 0.6  # variance of the difference of two blocks over the sum of theirs: 1 if they have nothing in common
NOISE_GREY = 2.5  # grey levels by which blocks of one grey may differ
SUBPIXEL = 16.0  # OpenCV's disparities are in sixteenths


@dataclass(frozen=True, slots=True)
class PairPoints:
    """What a pair shows.

    Attributes:
        points_map: (N, 3) surface points [m].
        camera_map: (3,) middle of the two cameras [m].
        noise_m: standard deviation of the height of one point, from its disparity, at the median depth.
        pose_m: standard deviation of the height that all points share, from the motion between the views.
        share: of the common window for which a disparity was found.
    """

    points_map: Array
    camera_map: Array
    noise_m: float
    pose_m: float
    share: float


def match(pair: RectifiedPair, settings: SurfaceSettings) -> PairPoints:
    """Match a pair; there may be no points."""
    left, right = pair.images()
    inside = [cv2.erode(image, BORDER, borderValue=0) > 0 for image in (left, right)]
    disparity = _searched(pair, left, right)
    good = (disparity >= pair.first) & (disparity + pair.shift_px > 0.0) & inside[0]
    good &= _seen_by_both(disparity, good, inside[1])
    disparity, alike = _refined(disparity, good, left, right)
    v, u = np.nonzero(good & alike)
    depth_m = pair.depth_m(disparity[v, u])
    points = pair.points_map(u.astype(np.float32), v.astype(np.float32), depth_m)
    noise_m, pose_m = sigmas_m(pair, float(np.median(depth_m)) if len(depth_m) else 1.0, settings)
    middle = 0.5 * (pair.left.T_map_cam.t + pair.right.T_map_cam.t)
    common = int(np.count_nonzero(inside[0] & inside[1]))
    return PairPoints(points, middle, noise_m, pose_m, len(points) / max(common, 1))


def sigmas_m(pair: RectifiedPair, depth_m: float, settings: SurfaceSettings) -> tuple[float, float]:
    """Return standard deviations of heights at a depth: of each point by itself, and of the whole pair.

    From Z = f B / d: dZ = Z^2/(f B) dd, dZ = Z/B dB, and a turn a about the axis across shifts every disparity by
    about f a.
    """
    lever = depth_m**2 / pair.baseline_m
    noise = lever / pair.focal_px * settings.match_px
    return noise, float(
        np.hypot(depth_m / pair.baseline_m * settings.relative_position_m, lever * settings.relative_attitude_rad)
    )


def _searched(pair: RectifiedPair, left: Grey, right: Grey) -> Floats:
    """Return the (H, W) disparity of the windows [px]; below the first one where nothing was found."""
    matcher = cv2.StereoSGBM_create(
        minDisparity=pair.first,
        numDisparities=pair.count,
        blockSize=BLOCK_PX,
        P1=SMALL_STEP,
        P2=LARGE_STEP,
        disp12MaxDiff=LEFT_RIGHT_PX,
        preFilterCap=PREFILTER,
        uniquenessRatio=UNIQUENESS,
        speckleWindowSize=SPECKLE_PX,
        speckleRange=SPECKLE_RANGE,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    return np.asarray(matcher.compute(left, right).astype(np.float32) / SUBPIXEL)


def _seen_by_both(disparity: Floats, good: Mask, inside_right: Mask) -> Mask:
    """Return where the matched pixel lies inside of the right image."""
    v, u = np.nonzero(good)
    other = np.rint(u - disparity[v, u]).astype(np.intp)
    seen = (other >= 0) & (other < good.shape[1])
    seen[seen] = inside_right[v[seen], other[seen]]
    both = np.zeros_like(good)
    both[v[seen], u[seen]] = True
    return both


def _refined(disparity: Floats, good: Mask, left: Grey, right: Grey) -> tuple[Floats, Mask]:
    """Return disparities after a least-squares step each, for a block of its own brightness, and where blocks agree.

    The interpolation of the matching costs prefers whole pixels, which shows as terraces; this has no such preference.
    """
    v, u = np.indices(disparity.shape, np.float32)
    weight = good.astype(np.float32)
    there = np.where(good, u - disparity, -1.0).astype(np.float32)
    warped = cv2.remap(right.astype(np.float32), there, v, cv2.INTER_LINEAR)
    slope = 0.125 * cv2.Sobel(warped, cv2.CV_32F, 1, 0) * weight
    residual = (left - warped) * weight

    def block(image: Floats) -> Floats:
        return np.asarray(cv2.boxFilter(image, cv2.CV_32F, (REFINED_PX, REFINED_PX), normalize=False))

    count = np.maximum(block(weight), 1.0)

    def product(a: Floats, b: Floats) -> Floats:  # of deviations from the block's means
        return np.asarray(block(a * b) - block(a) * block(b) / count)

    step = -product(slope, residual) / np.maximum(product(slope, slope), 1e-3)
    ours, theirs = left * weight, warped * weight
    different = product(residual, residual)
    alike = different < UNLIKE * (product(ours, ours) + product(theirs, theirs))
    alike |= different < NOISE_GREY**2 * count
    return np.asarray(disparity + np.where(np.abs(step) < LARGEST_STEP_PX, step, 0.0)), alike
