# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.evaluation.alignment import align_se3, align_start_pose, align_start_yaw, align_yaw
from uav_vslam.geometry.rotation import rpy_from_rotation, so3_exp

RNG = np.random.default_rng(4)
TRUTH = RNG.normal(0, 10, (60, 3))
ESTIMATE = (TRUTH + RNG.normal(0, 0.5, TRUTH.shape)) @ so3_exp([0.1, -0.2, 0.8]) + [1.0, 2.0, 3.0]


def cost(R):
    """Return the squared distances after rotation R and the best translation."""
    residual = (ESTIMATE - ESTIMATE.mean(axis=0)) @ R.T - (TRUTH - TRUTH.mean(axis=0))
    return float(np.sum(residual**2))


@pytest.mark.parametrize(("align", "axes"), [(align_se3, np.eye(3)), (align_yaw, np.eye(3)[2:])])
def test_no_other_rotation_of_the_kind_is_better(align, axes):
    T = align(ESTIMATE, TRUTH)
    for axis in axes:
        for angle in (-1e-3, 1e-3):
            assert cost(so3_exp(angle * axis) @ T.R) > cost(T.R)
    np.testing.assert_allclose(T.apply(ESTIMATE).mean(axis=0), TRUTH.mean(axis=0), atol=1e-9)


def test_yaw_alignment_rotates_about_z_only():
    roll, pitch, _ = rpy_from_rotation(align_yaw(ESTIMATE, TRUTH).R)
    assert abs(roll) < 1e-12
    assert abs(pitch) < 1e-12


def test_a_mirrored_shape_is_not_mirrored_back():
    R = align_se3(TRUTH * [1.0, 1.0, -1.0], TRUTH).R
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize(("align", "start"), [(align_start_yaw, ESTIMATE[0]), (align_start_pose, TRUTH[0])])
def test_the_start_stays_or_joins_the_true_one_and_no_other_heading_there_is_better(align, start):
    T = align(ESTIMATE, TRUTH)
    np.testing.assert_allclose(T.apply(ESTIMATE[0]), start, atol=1e-12)
    roll, pitch, _ = rpy_from_rotation(T.R)
    assert max(abs(roll), abs(pitch)) < 1e-12

    def squares(R):
        return float(np.sum(((ESTIMATE - ESTIMATE[0]) @ R.T + start - TRUTH) ** 2))

    for angle in (-1e-3, 1e-3):
        assert squares(so3_exp([0.0, 0.0, angle]) @ T.R) > squares(T.R)
