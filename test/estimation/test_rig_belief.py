# SPDX-License-Identifier: Apache-2.0
"""The evidence against a calibration."""

import numpy as np
import pytest
from scipy.stats import chi2

from uav_vslam.config import RigConfig
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.rig_belief import rig_evidence
from uav_vslam.estimation.rig_errors import RigErrors, RigState
from uav_vslam.simulation.rig import kagaru_rig

NAV = 15
LIMIT = chi2.ppf(1.0 - 1e-8, 5)


@pytest.mark.parametrize("learnt", [0.3, 0.9, 0.999999], ids="share {}".format)
@pytest.mark.parametrize(("turned_deg", "is_wrong"), [(0.0, False), (0.004, False), (0.02, True)])
def test_an_attitude_is_evidence_only_if_it_is_more_than_any_calibration_is_off(
    learnt: float, turned_deg: float, is_wrong: bool
) -> None:
    """The estimate of a turn about the disparity axis goes the learnt share of the way."""
    errors = RigErrors(kagaru_rig(), RigConfig(), NAV)
    axis = int(np.argmin(np.diagonal(errors.prior_covariance)[:3]))
    P = np.eye(NAV + errors.dim)
    P[NAV:, NAV:] = errors.prior_covariance
    P[NAV + axis, NAV + axis] *= 1.0 - learnt
    state = RigState(attitude=learnt * np.deg2rad(turned_deg) * np.eye(3)[axis])
    assert (rig_evidence(CovarianceBelief(P, NAV + errors.dim), errors, state) > LIMIT) == is_wrong
