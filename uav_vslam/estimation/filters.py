# SPDX-License-Identifier: Apache-2.0
"""The filters by name, as `backend.filter` selects them; each works with every state model."""

import dataclasses
from collections.abc import Callable
from functools import partial

from uav_vslam.config import VehicleConfig
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.linearisation import Cubature, Jacobians
from uav_vslam.estimation.square_root import SquareRootBelief
from uav_vslam.estimation.thesis_unscented import ThesisUnscentedFilter
from uav_vslam.geometry.stereo import StereoRig
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
BOUNDED = ("uhf", "thesis_uhf")  # filters that use `backend.gamma`


def make_filter(initial: NavEstimate, *, rig: StereoRig, config: VehicleConfig) -> Filter:
    """Return the configured filter."""
    backend, rig_config = config.backend, config.rig
    if is_of_thesis(config):
        rig_config = dataclasses.replace(rig_config, disparity_sigma_px=0.0)
    return FILTERS[backend.filter](
        initial,
        rig=rig,
        imu=config.imu,
        model=backend.model,
        gamma=backend.gamma if backend.filter in BOUNDED else None,
        sigma_px=backend.sigma_px,
        depth_sigma_ratio=backend.depth_sigma_ratio,
        robust=backend.robust,
        rig_config=rig_config,
        track_sigma_px=backend.track_sigma_px,
    )


def past_poses(config: VehicleConfig) -> int:
    """Return how many past poses the filter keeps.

    None with the thesis's own filters and states, nor for a flexing rig: a vibration is estimated in its frame only.
    """
    return 0 if is_of_thesis(config) or config.rig.flexing else config.backend.window


def is_of_thesis(config: VehicleConfig) -> bool:
    """Return whether filter or states are those of the thesis, which knows neither disparity errors nor past poses."""
    return config.backend.filter in THESIS or config.backend.model == "euler9"
