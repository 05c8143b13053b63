# SPDX-License-Identifier: Apache-2.0
"""A calibration's tables and picture."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from board_scene import HEIGHT, WIDTH, corner_pairs, rig_of
from rich.console import Console

from uav_vslam.calibration.boards import Chessboard
from uav_vslam.calibration.procedure import Boards, Rejected, StereoCalibration, calibrate
from uav_vslam.calibration.solve import Lens
from uav_vslam.calibration.summary import build_summary
from uav_vslam.report.calibration_plot import calibration_plot, write_calibration_plot
from uav_vslam.report.calibration_table import print_calibration

BOARD = Chessboard(9, 6, 0.03)


@pytest.fixture(scope="module")
def found() -> StereoCalibration:
    pairs = corner_pairs(rig_of(), BOARD, 10, np.random.default_rng(1), sigma_px=0.15)
    boards = Boards(pairs, [Rejected("blurred [1]", "no board found in the left image")], (WIDTH, HEIGHT))
    return calibrate(boards, Lens("plumb_bob", ("k3",)))


def test_the_tables_tell_cameras_halves_pairs_and_what_was_rejected(found: StereoCalibration) -> None:
    stream = io.StringIO()
    summary = build_summary(found, BOARD, name="test", git=None)
    print_calibration(summary, Console(file=stream, width=80))
    text = stream.getvalue()
    assert "10 pairs used, 1 rejected; stereo reprojection 0.2" in text
    for cells in (("fx [px]", "±"), ("all", "–", f"{found.solution.rig.baseline_m:.3f}"), ("difference", "%"), ("09",)):
        assert [line for line in text.splitlines() if all(cell in line for cell in cells)], cells
    assert "k3" not in text  # it was not estimated
    assert "rejected blurred [1]: no board found in the left image" in text


def test_the_summary_is_json_whose_errors_are_those_of_the_residuals(found: StereoCalibration) -> None:
    summary = json.loads(json.dumps(build_summary(found, BOARD, name="test", git=None), allow_nan=False))
    squares = [np.sum(part**2, axis=1) for pair in found.solution.residuals for part in pair]
    assert summary["reprojection_px"]["stereo"] == pytest.approx(np.sqrt(np.mean(np.concatenate(squares))))
    assert summary["pairs"][3]["left"] == pytest.approx(np.sqrt(np.mean(squares[6])))
    assert summary["cameras"]["right"]["parameters"]["fx"] == found.solution.rig.right.fx


def test_the_picture_shows_every_corner_and_pair(found: StereoCalibration, tmp_path: Path) -> None:
    left, right, errors = calibration_plot(found, "test").axes
    for axes, side in ((left, "left"), (right, "right")):
        corners = np.concatenate([getattr(pair, side).pixels for pair in found.pairs])
        np.testing.assert_array_equal(axes.lines[0].get_xydata(), corners)
        assert axes.get_ylim() == (HEIGHT, 0)  # v points down
    assert [label.get_text() for label in errors.get_xticklabels()] == [pair.name for pair in found.pairs]
    assert write_calibration_plot(found, "test", tmp_path).stat().st_size > 10_000


def test_residuals_point_from_the_prediction_to_the_corner(found: StereoCalibration) -> None:
    """Shifting all left corners of a drawing by the residuals' own size shifts no arrow."""
    arrows = calibration_plot(found, "test").axes[0].collections[0]
    residuals = np.concatenate([pair[0] for pair in found.solution.residuals])
    cosine = np.sum(np.stack([arrows.U, arrows.V], axis=1) * residuals, axis=1)
    assert (cosine > 0).all()
    doubled = replace(found.solution, residuals=[(2 * left, 2 * right) for left, right in found.solution.residuals])
    again = calibration_plot(replace(found, solution=doubled), "test").axes[0].collections[0]
    np.testing.assert_allclose(np.abs(again.U).max(), np.abs(arrows.U).max(), rtol=0.2)  # the magnification adapts
