# SPDX-License-Identifier: Apache-2.0
"""What a calibration reports, as the content of its summary.json."""

from typing import Any

import numpy as np

from uav_vslam.calibration.boards import Board
from uav_vslam.calibration.procedure import StereoCalibration, coverage
from uav_vslam.calibration.solve import StereoSolution, rms
from uav_vslam.geometry.stereo import SIDES

Figures = dict[str, Any]


def build_summary(found: StereoCalibration, board: Board, *, name: str, git: str | None) -> Figures:
    """Return the figures of a calibration.

    Args:
        found: the result.
        board: that was seen.
        name: of the result.
        git: revision of the code.
    """
    solution, check = found.solution, found.check
    return {
        "name": name,
        "git": git,
        "board": {"columns": board.columns, "rows": board.rows, "square_m": board.square_m},
        "model": found.lens.model,
        "fixed": list(found.lens.fixed),
        "image_size": list(solution.rig.left.size),
        "pairs_used": len(found.pairs),
        "reprojection_px": _errors(solution.residuals),
        "baseline_m": solution.rig.baseline_m,
        "sigma_baseline_m": solution.sigma_baseline_m,
        "rotation_deg": _angle_deg(solution.rig.T_right_left.R),
        "cameras": {side: _camera(found, side) for side in SIDES},
        "halves": {
            "baseline_m": [half.rig.baseline_m for half in check.halves],
            "sigma_baseline_m": [half.sigma_baseline_m for half in check.halves],
            "baseline_difference": check.baseline_difference,
            "focal_px": [[getattr(half.rig, side).fx for side in SIDES] for half in check.halves],
            "focal_difference": check.focal_difference,
            "own_reprojection_px": list(check.own_px),
            "other_reprojection_px": list(check.other_px),
        },
        "pairs": [
            {"name": pair.name, **_errors([residuals])}
            for pair, residuals in zip(found.pairs, solution.residuals, strict=True)
        ],
        "rejected": [{"name": pair.name, "reason": pair.reason} for pair in found.rejected],
        "warnings": found.warnings,
    }


def _errors(residuals: Any) -> Figures:
    left, right = ([pair[side] for pair in residuals] for side in range(2))
    return {"left": rms(left), "right": rms(right), "stereo": rms([*left, *right])}


def _camera(found: StereoCalibration, side: str) -> Figures:
    camera, sigma = getattr(found.solution.rig, side), _sigma(found.solution, side)
    names = ("fx", "fy", "cx", "cy", *found.lens.names)
    values = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    return {
        "parameters": {name: float(value) for name, value in zip(names, values, strict=True)},
        "sigma": {name: float(value) for name, value in zip(names, sigma, strict=True)},
        "coverage": coverage(found, side),
    }


def _sigma(solution: StereoSolution, side: str) -> Any:
    return solution.sigma_left if side == "left" else solution.sigma_right


def _angle_deg(R: Any) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0))))
