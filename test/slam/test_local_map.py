# SPDX-License-Identifier: Apache-2.0
"""How much landmarks count that have come back."""

import numpy as np

from uav_vslam.config import BackendConfig
from uav_vslam.slam.local_map import VISIT_FRAMES, visit_weights


def test_the_frames_of_a_visit_weigh_as_measurements_with_one_common_error() -> None:
    """Dense reference: the redetection error of a landmark that came back is the same in all its frames."""
    S = 0.5**2 * np.eye(VISIT_FRAMES) + 1.5**2 * np.ones((VISIT_FRAMES, VISIT_FRAMES))
    information = np.linalg.solve(S, np.ones(VISIT_FRAMES)).sum()
    back, other = visit_weights(np.array([True, False]), BackendConfig(sigma_px=0.5, redetection_px=1.5))
    np.testing.assert_allclose(VISIT_FRAMES * back / 0.5**2, information, rtol=1e-12)
    assert other == 1.0
