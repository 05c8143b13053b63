# SPDX-License-Identifier: Apache-2.0
"""What the smoother gets of a flight: start state, motion, features, and the filter's estimates and association."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.types import ImuIncrement, NavEstimate, NavState, StereoFeatures


@dataclass(frozen=True, slots=True)
class FilteredFrame:
    """A frame as the filter left it.

    Attributes:
        state: the filter's estimate, only to linearise at.
        increment: motion since the frame before, for the first since the start; None for a frame at the start itself.
        features: of the frame; descriptors are not used.
        sightings: (K, 2) landmark identifier and feature row of what the filter associated.
    """

    state: NavState
    increment: ImuIncrement | None
    features: StereoFeatures
    sightings: NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class FilteredFlight:
    """A finished flight.

    Attributes:
        start: start state with its covariance, the only prior.
        frames: in stamp order.
        flexing: its rig was found to flex, whatever the settings say.
    """

    start: NavEstimate
    frames: tuple[FilteredFrame, ...]
    flexing: bool = False

    @staticmethod
    def of(start: NavEstimate, frames: Iterable[FilteredFrame], *, flexing: bool = False) -> "FilteredFlight":
        """Collect a flight.

        Raises:
            ValueError: the increments do not join the frames to each other and to the start.
        """
        flight = FilteredFlight(start, tuple(frames), flexing)
        before_ns = start.state.stamp_ns
        for frame in flight.frames:
            stamp_ns, motion = frame.features.stamp_ns, frame.increment
            joined = stamp_ns if motion is None else motion.start_ns
            if joined != before_ns or stamp_ns != (stamp_ns if motion is None else motion.stamp_ns):
                raise ValueError(f"no motion is given from {before_ns} ns to the frame at {stamp_ns} ns")
            before_ns = stamp_ns
        return flight

    @staticmethod
    def of_outputs(
        start: NavEstimate, outputs: Iterable[FrameOutput], features: Mapping[int, StereoFeatures]
    ) -> "FilteredFlight":
        """Collect a flight from what the back end returned and the features of each stamp [ns]."""
        known = list(outputs)
        late = [output.report.late_sightings for output in known[1:]] + [np.zeros((0, 2), np.intp)]
        return FilteredFlight.of(
            start,
            (
                FilteredFrame(
                    output.report.nav.state,
                    output.increment,
                    features[output.report.pose.stamp_ns],
                    np.vstack([output.report.sightings, afterwards]),
                )
                for output, afterwards in zip(known, late, strict=True)
            ),
            flexing=any(output.report.flexing for output in known),
        )

    @property
    def states(self) -> list[NavState]:
        """The start, then the filter's estimate of each frame that is not at the start."""
        return [self.start.state, *(frame.state for frame in self.frames if frame.increment is not None)]

    @property
    def increments(self) -> list[ImuIncrement]:
        """The motion to each state but the start."""
        return [frame.increment for frame in self.frames if frame.increment is not None]

    @property
    def state_rows(self) -> NDArray[np.intp]:
        """(F,) row in `states` of each frame."""
        return np.cumsum([frame.increment is not None for frame in self.frames]).astype(np.intp)
