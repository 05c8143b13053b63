# SPDX-License-Identifier: Apache-2.0
"""Dense matching of a rectified pair: semi-global matching [hirschmuller08] by OpenCV."""

import dataclasses
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
BORDER = np.ones((3, 3), np.uint8)  # blocks half over the edge of an image match its outline
SMOOTHED_PX = 0.8  # standard deviation of a blur for which linear interpolation and differences are exact enough
REFINED_PX = 7  # side of the block of the least-squares step
LARGEST_STEP_PX = 0.75
UNLIKE = 0.3  # variance of the difference of two blocks over the sum of theirs: 1 if they share nothing but noise
TOGETHER = 3.0  # errors of disparities over those of independent pixels: blocks overlap, and share the pattern's bias
SPARSE = 16  # every so many points suffice for a median
SUBPIXEL = 16.0  # OpenCV's disparities are in sixteenths


@dataclass(frozen=True, slots=True)
class PairPoints:
    """What a pair shows.

    Attributes:
        points_map: (N, 3) surface points, each axis contiguous [m].
        camera_map: (3,) middle of the two cameras [m].
        depth_map: (3,) direction of depth.
        fall_m: of the median point below the cameras.
        noise_m: standard deviation of the height of a point at that fall and as great a depth, from its disparity.
        pose_m: standard deviation of the height that all points share, from the motion between the views; there too.
        share: of the common window for which a disparity was found.
    """

    points_map: Floats
    camera_map: Array
    depth_map: Array
    fall_m: float
    noise_m: float
    pose_m: float
    share: float

    def lever(self, points_map: Array) -> Array:
        """Return how many times larger than `noise_m` and `pose_m` the errors of (N, 3) points' heights are.

        A depth Z errs by Z^2, and the height by the share of it that is the fall H: by Z H.
        """
        apart = points_map - self.camera_map
        return np.asarray((apart @ self.depth_map) * -apart[:, 2] / self.fall_m**2)

    def above(self, low_m: float) -> "PairPoints":
        """Return the points between a height [m] and the cameras': a disparity near that of infinity is far away."""
        height = self.points_map[:, 2]
        kept = np.flatnonzero((height >= low_m) & (height < self.camera_map[2]))
        share = self.share * len(kept) / len(height) if len(height) else 0.0
        points = self.points_map.T.take(kept, axis=1).T  # each axis stays contiguous
        return dataclasses.replace(self, points_map=points, share=share)


def match(pair: RectifiedPair, settings: SurfaceSettings) -> PairPoints:
    """Match a pair; there may be no points."""
    left, right = pair.images()
    inside = [cv2.erode(image, BORDER, borderValue=0) > 0 for image in (left, right)]
    disparity = _searched(pair, left, right)
    good = (disparity >= pair.first) & (disparity + pair.shift_px > 0.0) & inside[0]
    smooth = [cv2.GaussianBlur(image, (0, 0), SMOOTHED_PX) for image in (left, right)]
    disparity, good, error_px = _refined(disparity, good, smooth[0], np.where(inside[1], smooth[1], 0))
    good &= disparity + pair.shift_px > 0.0  # a step may lead past infinity
    points = pair.points_map(disparity, good)
    middle = 0.5 * (pair.left.T_map_cam.t + pair.right.T_map_cam.t)
    below_m = middle[2] - float(np.median(points[::SPARSE, 2])) if len(points) else 1.0
    noise_m, pose_m = sigmas_m(pair, below_m, settings, _match_px(error_px[good][::SPARSE], settings))
    common = int(np.count_nonzero(inside[0] & inside[1]))
    share = len(points) / max(common, 1)
    return PairPoints(points, middle, pair.R_map_rect[:, 2], below_m, noise_m, pose_m, share)


def sigmas_m(pair: RectifiedPair, depth_m: float, settings: SurfaceSettings, match_px: float) -> tuple[float, float]:
    """Return standard deviations of heights at a depth: of each point by itself, and of the whole pair.

    From Z = f B / d: dZ = Z^2/(f B) dd, dZ = Z/B dB, and a turn a about the axis across shifts every disparity by
    about f a.
    """
    lever = depth_m**2 / pair.baseline_m
    noise = lever / pair.focal_px * match_px
    return noise, float(
        np.hypot(depth_m / pair.baseline_m * settings.relative_position_m, lever * settings.relative_attitude_rad)
    )


def _match_px(errors_px: Floats, settings: SurfaceSettings) -> float:
    """Return the standard deviation of a disparity: the usual one, or more where (N,) least-squares steps err more."""
    return max(settings.match_px, TOGETHER * float(np.median(errors_px))) if len(errors_px) else settings.match_px


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


def _refined(disparity: Floats, good: Mask, left: Grey, right: Grey) -> tuple[Floats, Mask, Floats]:
    """Return disparities after a least-squares step each, for a block of its own brightness; which are right; errors.

    The interpolation of the matching costs prefers whole pixels, which shows as terraces; this has no such preference.
    Right are those whose pixel lies inside of the right image, where the blocks agree. The error is the standard
    deviation of the step by what it leaves over, as if the pixels of a block erred independently.
    """
    columns = np.arange(disparity.shape[1], dtype=np.float32)
    rows = np.arange(disparity.shape[0], dtype=np.float32)[:, None]
    there = np.where(good, columns - disparity, np.float32(-1.0))
    warped = cv2.remap(right.astype(np.float32), there, np.broadcast_to(rows, there.shape).copy(), cv2.INTER_LINEAR)
    good = good & (warped >= 1.0)
    weight = good.astype(np.float32)
    slope = np.float32(0.125) * cv2.Sobel(warped, cv2.CV_32F, 1, 0) * weight
    ours, theirs = left * weight, warped * weight
    residual = ours - theirs

    count = np.maximum(_block(weight), np.float32(1.0))
    sums = [_block(image) / count for image in (slope, residual, ours, theirs)]

    def product(a: Floats, b: Floats, i: int, j: int) -> Floats:  # mean, of deviations from the block's means
        return np.asarray(_block(a * b) / count - sums[i] * sums[j])

    texture = np.maximum(product(slope, slope, 0, 0), np.float32(1e-3))
    common = product(slope, residual, 0, 1)
    step = -common / texture
    different = product(residual, residual, 1, 1)
    error = np.sqrt(np.maximum(different - common * common / texture, np.float32(0.0)) / (texture * count))
    alike = different < UNLIKE * (product(ours, ours, 2, 2) + product(theirs, theirs, 3, 3))
    return disparity + np.where(np.abs(step) < LARGEST_STEP_PX, step, np.float32(0.0)), good & alike, error


def _block(image: Floats) -> Floats:
    return np.asarray(cv2.boxFilter(image, cv2.CV_32F, (REFINED_PX, REFINED_PX), normalize=False))
