# SPDX-License-Identifier: Apache-2.0
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.rotation import so3_log
from uav_vslam.types import NavState


def map_error(true: NavState, state: NavState) -> NDArray[np.float64]:
    """Return the map-frame error: plain differences, and xi with R_true = Exp(xi) R."""
    return np.concatenate(
        [
            true.T_map_body.t - state.T_map_body.t,
            true.v_map - state.v_map,
            so3_log(true.T_map_body.R @ state.T_map_body.R.T),
            true.gyro_bias - state.gyro_bias,
            true.accel_bias - state.accel_bias,
        ]
    )
