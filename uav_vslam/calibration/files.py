# SPDX-License-Identifier: Apache-2.0
"""Calibration files that `input.calibration` reads: ROS camera_info YAML of both cameras, and Kalibr's camchain."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from uav_vslam.datasets.kalibr_camchain import camchain, kalibr_knows
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.stereo import SIDES, StereoRig

Array = NDArray[np.float64]


def write_calibration(rig: StereoRig, folder: Path) -> list[Path]:
    """Write `left.yaml` and `right.yaml`, and `camchain.yaml` if Kalibr knows the distortion model.

    Args:
        rig: cameras.
        folder: that exists.

    Returns:
        The files; the first two, or the last one alone, describe the whole rig.
    """
    written = []
    for name, camera, R, P in zip(SIDES, (rig.left, rig.right), *rectification(rig), strict=True):
        written.append(_write(folder / f"{name}.yaml", camera_info(name, camera, R, P)))
    if kalibr_knows(rig):
        written.append(_write(folder / "camchain.yaml", camchain(rig)))
    return written


def rectification(rig: StereoRig) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return R and P of both cameras as CameraInfo defines them: rotation to and projection of the rectified pair."""
    size = rig.left.size
    T = rig.T_right_left
    if rig.left.model == "equidistant":
        R_left, R_right, P_left, P_right, _ = cv2.fisheye.stereoRectify(
            rig.left.K, rig.left.distortion, rig.right.K, rig.right.distortion, size, T.R, T.t, flags=0
        )
    else:
        R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
            rig.left.K, rig.left.distortion, rig.right.K, rig.right.distortion, size, T.R, T.t, alpha=0
        )
    return (R_left, R_right), (P_left, P_right)


def camera_info(name: str, camera: PinholeCamera, R: Array, P: Array) -> dict[str, Any]:
    """Return what ROS's camera_calibration_parsers reads."""
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(camera.K),
        "distortion_model": camera.model,
        "distortion_coefficients": _matrix(camera.distortion[None]),
        "rectification_matrix": _matrix(R),
        "projection_matrix": _matrix(P),
    }


def _matrix(values: Array) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": np.ravel(values).tolist()}


def _write(path: Path, tree: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")
    return path
