# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles as sources for the offline graph, without a bag in between."""

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.landmarks import LandmarkField, LandmarkNoise, observe
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.types import ImuSample, NavEstimate, StereoFeatures, StereoFrame


@dataclass(frozen=True, slots=True)
class SimulatedSource:
    """A simulated vehicle: rendered images, or stereo features from landmarks or precomputed.

    Attributes:
        simulated: the flight.
        field: landmarks for the image-free path, None for rendered images.
        noise: quality of the image-free features.
        features: precomputed front-end output, in stamp order; None for none.
    """

    simulated: SimulatedVehicle
    field: LandmarkField | None = None
    noise: LandmarkNoise | None = None
    features: tuple[StereoFeatures, ...] | None = None

    @property
    def vehicle(self) -> str:
        """Name."""
        return self.simulated.name

    @property
    def rig(self) -> StereoRig:
        """The calibration that the vehicle uses."""
        return self.simulated.rig

    @property
    def initial_state(self) -> NavEstimate:
        """Start state with its errors."""
        return self.simulated.initial

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.simulated.frame_stamps_ns) if self.features is None else len(self.features)

    def unpaired_reason(self) -> str:
        """Return nothing: all images are pairs."""
        return ""

    def frames(self) -> Iterable[StereoFrame | StereoFeatures]:
        """Yield stereo frames or features."""
        if self.features is not None:
            return self.features
        if self.field is None:
            return RenderedFlight(self.simulated)
        return (features for features, _ in observe(self.simulated, self.field, noise=self.noise))

    def iter_events(self) -> Iterator[ImuSample | StereoFrame | StereoFeatures]:
        """Yield sensor data in stamp order."""
        return heapq.merge(self.simulated.imu.samples(), self.frames(), key=lambda event: event.stamp_ns)
