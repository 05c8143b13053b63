# SPDX-License-Identifier: Apache-2.0
"""The sensor data of a vehicle, and its start state by the configured method."""

from collections.abc import Iterable
from typing import Protocol

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.alignment import static_alignment
from uav_vslam.ins.startup_buffer import first_rest
from uav_vslam.types import ImuSample, NavEstimate, StereoFeatures, StereoFrame


class FlightSource(Protocol):
    """One vehicle's sensor data, recorded or simulated; it must be picklable, for a worker process."""

    @property
    def vehicle(self) -> str:
        """Name."""

    @property
    def rig(self) -> StereoRig:
        """Calibration."""

    @property
    def initial_state(self) -> NavEstimate | None:
        """Start state, or None."""

    @property
    def frame_count(self) -> int:
        """Number of left images, paired or not."""

    def unpaired_reason(self) -> str:
        """Return why images found no partner."""

    def iter_events(self) -> Iterable[ImuSample | StereoFrame | StereoFeatures]:
        """Yield sensor data in stamp order."""


def start_state(source: FlightSource, config: VehicleConfig) -> NavEstimate | None:
    """Return the start state, None if it is to be estimated in flight.

    Raises:
        UavVslamError: there is none, the vehicle does not rest where it is to be found at rest, or there is no map to
            find it in.
    """
    if config.start.method == "map" and not config.start.map:
        raise UavVslamError(
            f"{source.vehicle}: start.method: map needs a map of an earlier flight; set start.map (--map)"
        )
    if config.start.searches:
        return None
    if config.start.method == "static":
        return _static_start(source, config)
    if source.initial_state is None:
        raise UavVslamError(
            f"{source.vehicle}: the recording has no {source.vehicle}/initial_state; record one, or set "
            "start.method: static for a vehicle that starts at rest, in_flight for one that is already flying, map for "
            "one over ground that it has a map of"
        )
    return source.initial_state


def _static_start(source: FlightSource, config: VehicleConfig) -> NavEstimate:
    events = source.iter_events()
    items = (event if isinstance(event, ImuSample) else event.stamp_ns for event in events)
    samples = first_rest(items, config.start.rest_s)
    try:
        return static_alignment(samples, samples[-1].stamp_ns if samples else 0, config.imu)
    except UavVslamError as error:
        raise UavVslamError(f"{source.vehicle}: {error}") from error
