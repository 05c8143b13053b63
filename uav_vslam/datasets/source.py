# SPDX-License-Identifier: Apache-2.0
"""A recorded flight as the offline graph wants it."""

from collections.abc import Iterator
from dataclasses import dataclass

from uav_vslam.datasets.bag import BagFlight
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.rotation import quaternion_wxyz_from_rotation
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import ImuSample, NavEstimate, StereoFrame


@dataclass(frozen=True, slots=True)
class BagSource:
    """A `pipeline` source that reads a bag."""

    flight: BagFlight

    @property
    def vehicle(self) -> str:
        """Name."""
        return self.flight.vehicle

    @property
    def rig(self) -> StereoRig:
        """Calibration."""
        return self.flight.rig

    @property
    def initial_state(self) -> NavEstimate | None:
        """Recorded start state."""
        return self.flight.initial_state

    def iter_events(self) -> Iterator[ImuSample | StereoFrame]:
        """Yield sensor data in stamp order."""
        return self.flight.iter_events()


def truth_trajectory(flight: BagFlight) -> Trajectory | None:
    """Return the recorded truth as a trajectory, None where there is none."""
    truth = flight.truth()
    if truth is None:
        return None
    return Trajectory(truth.stamps_ns, truth.positions_world, quaternion_wxyz_from_rotation(truth.R_world_body))
