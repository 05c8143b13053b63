# SPDX-License-Identifier: Apache-2.0
"""Copies of a flight that has begun, so that flights that begin alike share their beginning."""

import copy

from uav_vslam.slam.stage import SlamStage


def copy_of(stage: SlamStage) -> SlamStage:
    """Return a copy that flies on as the stage would; a checkpoint, and so a plain copy, leaves out earlier states."""
    copied = copy.deepcopy(stage)
    copied._flight._bias_steps = copy.deepcopy(stage._flight._bias_steps)
    return copied
