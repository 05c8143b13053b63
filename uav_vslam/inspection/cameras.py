# SPDX-License-Identifier: Apache-2.0
"""Calibration of the cameras and their images: present, plausible, and of the same size."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning
from uav_vslam.vision.image_watch import MIN_CONTRAST, STEP_PX, contrast
from uav_vslam.vision.images import to_grey8

CALIBRATE = "calibrate again, or check the file"


def check_camera(name: str, camera: PinholeCamera) -> list[Finding]:
    """Check that intrinsics are those of a usual camera."""
    fisheye = camera.model == "equidistant"
    sizes = camera.width / camera.fx, camera.height / camera.fy
    fields = [math.degrees(size if fisheye else 2.0 * math.atan(0.5 * size)) for size in sizes]
    narrowest, widest = limits.FISHEYE_FIELD_DEG if fisheye else limits.FIELD_OF_VIEW_DEG
    subject = f"{name} calibration"
    seen = (
        f"{camera.width}x{camera.height} px, f {camera.fx:.1f}, {camera.fy:.1f} px, centre ({camera.cx:.1f}, "
        f"{camera.cy:.1f}) px, field of view {fields[0]:.0f} x {fields[1]:.0f} deg, {camera.model}"
    )
    found = []
    if not narrowest <= fields[0] <= widest:
        allowed = f"field of view {narrowest:g} to {widest:g} deg"
        found.append(warning(subject, seen, allowed, f"is the focal length in pixels of this size? {CALIBRATE}"))
    low, high = limits.PIXEL_ASPECT
    if not low <= camera.fx / camera.fy <= high:
        found.append(warning(subject, seen, f"fx / fy from {low} to {high}: square pixels", CALIBRATE))
    low, high = limits.CENTRE_SHARE
    if not (low <= camera.cx / camera.width <= high and low <= camera.cy / camera.height <= high):
        remedy = f"was the image cropped or resized after the calibration? {CALIBRATE}"
        found.append(warning(subject, seen, "principal point in the middle half of the image", remedy))
    return found or [ok(subject, seen)]


def check_rig(rig: StereoRig) -> list[Finding]:
    """Check that two cameras of this rig see the same."""
    T_left_right = rig.T_right_left.inverse()
    angle_deg = math.degrees(math.acos(min(1.0, max(-1.0, float(T_left_right.R[2, 2])))))
    along = abs(float(T_left_right.t[2])) / rig.baseline_m
    t = ", ".join(f"{one:.4f}" for one in T_left_right.t)
    seen = f"right camera at ({t}) m in the left one, baseline {rig.baseline_m:.4f} m, axes {angle_deg:.1f} deg apart"
    remedy = "check the extrinsics: is a transform inverted, or between other frames?"
    found = []
    low, high = limits.BASELINE_M
    if rig.baseline_m > high:
        unit = f" (in millimetres: {rig.baseline_m / 1000:.4g} m)" if rig.baseline_m > 10 * high else ""
        found.append(error("baseline", f"{seen}{unit}", f"at most {high:g} m", "give translations in metres"))
    elif rig.baseline_m < low:
        found.append(warning("baseline", seen, f"at least {low:g} m", "give translations in metres"))
    elif along > limits.ALONG_AXIS_SHARE:
        found.append(warning("baseline", seen, "across the optical axis, not along it", remedy))
    if angle_deg > limits.VIEW_ANGLE_DEG:
        allowed = f"axes at most {limits.VIEW_ANGLE_DEG:g} deg apart, so that the views overlap"
        found.append(warning("camera axes", seen, allowed, remedy))
    return found or [ok("baseline", seen)]


def check_baseline_of_infos(rig: StereoRig, T_left_right: Pose | None) -> list[Finding]:
    """Check that the rig's baseline is the one in P of camera_info, which may be None."""
    if T_left_right is None:
        return []
    told_m = float(np.linalg.norm(T_left_right.t))
    if abs(told_m / rig.baseline_m - 1.0) <= limits.BASELINE_SHARE:
        return []
    seen = f"{rig.baseline_m:.4f} m by the places of the frames, {told_m:.4f} m by P of camera_info"
    remedy = "the former is used: correct the one that is wrong, as distances scale with it"
    return [warning("baseline", seen, f"one baseline, within {100 * limits.BASELINE_SHARE:g} %", remedy)]


def check_images(
    name: str, images: Sequence[NDArray[Any]], repeated: NDArray[np.bool_], camera: PinholeCamera | None
) -> list[Finding]:
    """Check the images of one camera.

    Args:
        name: of the camera.
        images: some of them, decoded.
        repeated: (N,) of all, whether one equals the one before.
        camera: its calibration, or None.
    """
    found = _check_size(name, images, camera) + (_check_contrast(name, images) or _check_repeated(name, repeated))
    if found or not images:
        return found
    height, width = images[0].shape[:2]
    return [ok(f"{name} images", f"{width}x{height} px, {images[0].dtype}, with contrast, none repeated")]


def _check_size(name: str, images: Sequence[NDArray[Any]], camera: PinholeCamera | None) -> list[Finding]:
    sizes = {(image.shape[1], image.shape[0]) for image in images}
    if camera is None or sizes <= {camera.size}:
        return []
    seen = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
    allowed = f"{camera.width}x{camera.height} px, as in the calibration"
    remedy = (
        "calibrate at that size, or give K for it: binning and region of interest of camera_info are applied to K, "
        "which is that of the whole sensor"
    )
    return [error(f"{name} image size", f"{seen} px", allowed, remedy)]


def _check_repeated(name: str, repeated: NDArray[np.bool_]) -> list[Finding]:
    share = float(repeated.mean()) if len(repeated) else 0.0
    if share <= limits.REPEATED_SHARE:
        return []
    seen = f"{repeated.sum()} of {len(repeated)} images equal the one before, first image {int(repeated.argmax()) + 1}"
    judge = error if share > limits.UNUSABLE_SHARE else warning
    return [judge(f"{name} images frozen", seen, "new pixels in each", "such pairs are not used: check the driver")]


def _check_contrast(name: str, images: Sequence[NDArray[Any]]) -> list[Finding]:
    levels = [_contrast(image) for image in images]
    blind = sum(level < MIN_CONTRAST for level in levels)
    if not levels or blind <= limits.BLIND_SHARE * len(levels):
        return []
    means = [float(image.mean()) for image in images]
    seen = f"{blind} of {len(levels)} sampled images show nothing (mean grey level {np.median(means):.0f})"
    judge = error if blind > limits.UNUSABLE_SHARE * len(levels) else warning
    remedy = "such pairs are not used: lens cap, exposure, or an empty topic?"
    return [judge(f"{name} images blind", seen, f"contrast of {MIN_CONTRAST:g} grey levels", remedy)]


def _contrast(image: NDArray[Any]) -> float:
    try:
        return contrast(to_grey8(image)[::STEP_PX, ::STEP_PX])
    except InvalidMessage:  # an empty image
        return 0.0
