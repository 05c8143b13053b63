# SPDX-License-Identifier: Apache-2.0
"""The filters by name, as `backend.filter` selects them; each works with every state model."""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from uav_vslam.config import RigConfig, VehicleConfig
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.linearisation import Cubature, Jacobians
from uav_vslam.estimation.square_root import SquareRootBelief
from uav_vslam.estimation.thesis_unscented import ThesisUnscentedFilter
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import ROTATION
from uav_vslam.types import NavEstimate

FILTERS: dict[str, Callable[..., Filter]] = {
    "eif": partial(Filter, form=InformationBelief, linearisation=Jacobians()),
    "ekf": partial(Filter, form=CovarianceBelief, linearisation=Jacobians()),
    "ukf": partial(Filter, form=SquareRootBelief, linearisation=Cubature()),
    "uhf": partial(Filter, form=SquareRootBelief, linearisation=Cubature()),
    "thesis_ukf": partial(ThesisUnscentedFilter, form=CovarianceBelief),
    "thesis_uhf": partial(ThesisUnscentedFilter, form=CovarianceBelief),
}
THESIS = ("thesis_ukf", "thesis_uhf")  # filters as the thesis gives them
LOST_ROTATION_SIGMA = 0.3  # [rad]: beyond, an offset of the clock, as it is linearised, would seem to show the heading
BOUNDED = ("uhf", "thesis_uhf")  # filters that use `backend.gamma`


def make_filter(initial: NavEstimate, *, rig: StereoRig, config: VehicleConfig) -> Filter:
    """Return the configured filter."""
    backend = config.backend
    return FILTERS[backend.filter](
        initial,
        rig=rig,
        imu=config.imu,
        model=backend.model,
        gamma=backend.gamma if backend.filter in BOUNDED else None,
        sigma_px=backend.sigma_px,
        depth_sigma_ratio=backend.depth_sigma_ratio,
        robust=backend.robust,
        rig_config=_rig_states(initial, config),
        track_sigma_px=backend.track_sigma_px,
    )


def _rig_states(initial: NavEstimate, config: VehicleConfig) -> RigConfig:
    """Return the uncertainty of the rig, without that which is no state of this filter."""
    rig, is_lost = config.rig, np.diagonal(initial.covariance)[ROTATION].max() > LOST_ROTATION_SIGMA**2
    if is_of_thesis(config):
        rig = dataclasses.replace(rig, disparity_sigma_px=0.0)
    return dataclasses.replace(rig, time_offset_sigma_s=0.0) if is_lost or is_of_thesis(config) else rig


def past_poses(config: VehicleConfig) -> int:
    """Return how many past poses the filter keeps.

    None with the thesis's own filters and states, nor for a flexing rig: a vibration is estimated in its frame only.
    """
    return 0 if is_of_thesis(config) or config.rig.flexing else config.backend.window


def is_of_thesis(config: VehicleConfig) -> bool:
    """Return whether filter or states are those of the thesis: no errors of disparity and clock, no past poses."""
    return config.backend.filter in THESIS or config.backend.model == "euler9"
