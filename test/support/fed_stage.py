# SPDX-License-Identifier: Apache-2.0
"""A stage that is given frames as they come."""

from collections.abc import Iterable

from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import ImuIncrement, StereoFeatures


def feed(stage: SlamStage, frames: Iterable[tuple[StereoFeatures, ImuIncrement | None]]) -> list[FrameOutput]:
    """Add frames one by one and return the outputs."""
    outputs: list[FrameOutput] = []
    for features, increment in frames:
        stage.add_features(features)
        if increment is not None:
            stage.add_increment(increment)
        outputs += stage.run()
    return outputs
