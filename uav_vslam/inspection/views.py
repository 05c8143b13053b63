# SPDX-License-Identifier: Apache-2.0
"""What a few image pairs show of the rig: epipolar residuals, order of the cameras, depths, and the camera's motion."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import FrontendConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning
from uav_vslam.inspection.two_views import Motion, motion_between
from uav_vslam.types import StereoFrame
from uav_vslam.vision.health import EPIPOLAR_SHARE, SWAPPED_SHARE, fitting_share, seems_swapped
from uav_vslam.vision.matching import match_descriptors
from uav_vslam.vision.stereo_points import GATED, StereoFrontend

Array = NDArray[np.float64]

DETECTION_WIDTH_PX = 640  # images are shrunk to it for detection: 50 ms each


@dataclass(frozen=True, slots=True)
class Step:
    """Motion of the left camera between two pairs.

    Attributes:
        start_ns, end_ns: stamps [ns].
        motion: between them.
    """

    start_ns: int
    end_ns: int
    motion: Motion


@dataclass(frozen=True, slots=True)
class Views:
    """What the sampled pairs show.

    Attributes:
        pixels: (M, 4) undistorted stereo points of all pairs, matched by descriptors alone.
        steps: motion within couples of pairs.
        flow_px: (K, 2) how far points of the couples should move in the left image by that motion, and how far they do.
    """

    pixels: Array
    steps: list[Step]
    flow_px: Array


def look(
    samples: Sequence[tuple[StereoFrame, StereoFrame | None]],
    rig: StereoRig,
    config: FrontendConfig,
) -> Views:
    """Match the sampled pairs, in themselves and from the first to the second of each couple."""
    scale = min(1.0, max(0.1, DETECTION_WIDTH_PX / rig.left.width))
    config = dataclasses.replace(config, method="sift", extractor="sift", matcher=GATED, scale=scale)
    frontend = StereoFrontend(rig, config)
    pixels, steps, flows = [np.zeros((0, 4))], [], [np.zeros((0, 2))]
    for first, second in samples:
        try:
            detected = frontend.detect(first)
            matches = match_descriptors(detected.left.descriptors, detected.right.descriptors, config.ratio)
            pixels.append(np.hstack([detected.pixels_left[matches[:, 0]], detected.pixels_right[matches[:, 1]]]))
            if second is not None:
                here, there = frontend.match(detected), frontend.match(frontend.detect(second))
                matches = match_descriptors(here.descriptors, there.descriptors, config.ratio)
                both = [one.pixels[rows].astype(float) for one, rows in zip((here, there), matches.T, strict=True)]
                motion = motion_between(both[0], both[1], rig)
                if motion is not None:
                    steps.append(Step(first.stamp_ns, second.stamp_ns, motion))
                    flows.append(_flow_px(both[0], both[1], motion, rig))
        except InvalidMessage:  # of another size than the calibration: the check of images says so
            pass
    found = np.vstack(pixels)
    return Views(found[np.isfinite(found).all(axis=1)], steps, np.vstack(flows))


def _flow_px(start: Array, end: Array, motion: Motion, rig: StereoRig) -> Array:
    """Return (K, 2) distances in the left image by the motion, and as seen, of (M, 4) points of two pairs."""
    moved = rig.project(motion.T_start_end.inverse().apply(rig.triangulate(start)))[:, :2]
    flow = np.stack([np.linalg.norm(one - start[:, :2], axis=1) for one in (moved, end[:, :2])], axis=1)
    return flow[np.isfinite(flow).all(axis=1)]


def check_flow(flow_px: Array) -> list[Finding]:
    """Check that hardly any points stand still in an image that moves, as `Views.flow_px` has them."""
    seen_px = flow_px[flow_px[:, 0] > limits.MOVING_PX, 1]
    if len(seen_px) < limits.MIN_MATCHES:
        return []
    still = int((seen_px < limits.STILL_PX).sum())
    moving = f"{len(seen_px)} points that should move by {limits.MOVING_PX:g} px or more"
    seen = f"{still} of {moving} stand still in the image"
    if still <= limits.STILL_SHARE * len(seen_px):
        return [ok("points that move", seen)]
    remedy = (
        "switch off a depth camera's projector (RealSense: depth_module.emitter_enabled: 0), clean the lenses, and "
        "keep parts of the vehicle out of view"
    )
    return [warning("points that move", seen, f"at most {100 * limits.STILL_SHARE:g} %", remedy)]


def check_geometry(pixels: Array, rig: StereoRig, config: FrontendConfig) -> list[Finding]:
    """Check (M, 4) undistorted stereo points, matched by descriptors alone, against the rig."""
    if len(pixels) < limits.MIN_MATCHES:
        seen, allowed = f"{len(pixels)} matches over all sampled pairs", f"at least {limits.MIN_MATCHES}"
        remedy = "do both cameras show the same, with texture, at the same time?"
        return [warning("stereo geometry", seen, allowed, remedy)]
    gate = config.epipolar_px
    distance = float(np.median(rig.epipolar_distance(pixels)))
    share = fitting_share(pixels, rig, gate)
    seen = f"{len(pixels)} matches, median {distance:.2f} px off their epipolar lines, {100 * share:.0f} % fit the rig"
    allowed = f"most within {gate:g} px (frontend.epipolar_px) and in front of both cameras"
    if seems_swapped(pixels, rig, gate):
        seen += f"; with left and right exchanged {100 * fitting_share(pixels[:, [2, 3, 0, 1]], rig, gate):.0f} %"
        remedy = (
            "left and right seem swapped: exchange input.topics.left and right, or invert the extrinsics; if both "
            "images are upside down, turn them by 180 degrees or calibrate with them as they are"
        )
        return [error("stereo geometry", seen, allowed, remedy)]
    inverted = dataclasses.replace(rig, T_body_right=rig.T_body_left @ rig.T_right_left)
    if share < 0.5 * SWAPPED_SHARE < SWAPPED_SHARE < fitting_share(pixels, inverted, gate):
        return [error("stereo geometry", seen, allowed, "the right camera's extrinsics seem inverted: invert them")]
    remedy = "check intrinsics and extrinsics (inverted, of another pair, of another size?) and that stamps are right"
    if share < 0.5 * SWAPPED_SHARE:
        return [error("stereo geometry", seen, allowed, remedy)]
    if distance > EPIPOLAR_SHARE * gate:
        remedy = "calibrate again, widen frontend.epipolar_px, or set rig.flexing"
        return [warning("stereo geometry", seen, f"at most {EPIPOLAR_SHARE * gate:g} px", remedy)]
    return [ok("stereo geometry", seen), *_check_depth(pixels, rig, config)]


def _check_depth(pixels: Array, rig: StereoRig, config: FrontendConfig) -> list[Finding]:
    depth = rig.triangulate(pixels)[:, 2]
    depth = depth[np.isfinite(depth)]
    low, median, high = np.percentile(depth, (16, 50, 84)) if len(depth) else (np.nan,) * 3
    inside = float(np.mean((depth >= config.min_depth_m) & (depth <= config.max_depth_m))) if len(depth) else 0.0
    seen = f"median depth {median:.3g} m, 16 to 84 % from {low:.3g} to {high:.3g} m"
    if inside >= limits.DEPTH_SHARE:
        return [ok("depth", seen)]
    allowed = f"{config.min_depth_m:g} to {config.max_depth_m:g} m (frontend.min_depth_m, max_depth_m)"
    remedy = (
        "set the depths of your scene, as other points are not used; impossible ones show another unit of the baseline"
    )
    return [warning("depth", f"{seen}; {100 * inside:.0f} % inside", allowed, remedy)]
