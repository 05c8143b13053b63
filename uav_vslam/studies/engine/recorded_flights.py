# SPDX-License-Identifier: Apache-2.0
"""Recordings with truth whose features have been extracted once."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.flight_writer import write_flights
from uav_vslam.datasets.importing.euroc import read_euroc
from uav_vslam.datasets.truth import trajectory_of
from uav_vslam.errors import BagError, InvalidMessage, UavVslamError
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.offline.source import FlightSource
from uav_vslam.studies.engine.study import Progress
from uav_vslam.types import ImuSample, NavEstimate, StereoFeatures, StereoFrame
from uav_vslam.vision.frontend_base import Frontend
from uav_vslam.vision.frontends import make_frontend

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """A recording with the front end's features; a `FlightSource`.

    Attributes:
        vehicle: name.
        rig: calibration.
        initial_state: recorded start.
        events: readings and features in stamp order.
        truth: true poses.
        velocities: (N, 3) true velocity at each of them [m/s].
    """

    vehicle: str
    rig: StereoRig
    initial_state: NavEstimate
    events: tuple[ImuSample | StereoFeatures, ...]
    truth: Trajectory
    velocities: Array

    def iter_events(self) -> tuple[ImuSample | StereoFeatures, ...]:
        """Return sensor data in stamp order."""
        return self.events

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.frame_stamps_ns)

    def unpaired_reason(self) -> str:
        """Return nothing: all images are pairs."""
        return ""

    @property
    def frame_stamps_ns(self) -> NDArray[np.int64]:
        """(F,) stamps of the frames [ns]."""
        return np.array([event.stamp_ns for event in self.events if isinstance(event, StereoFeatures)], np.int64)


def extracted_recording(
    recording: Path, vehicle: str | None, config: VehicleConfig, progress: Progress
) -> RecordedFlight:
    """Read a recording and extract features from its images."""
    with _opened(recording, vehicle) as flight:
        truth = flight.truth()
        if not truth:
            raise BagError(
                f"{recording} holds no {flight.vehicle}/ground_truth/odometry, which the study scores against"
            )
        advance = progress(flight.frame_count, "searching images")
        return searched(flight, config, truth=trajectory_of(truth), velocities=truth.velocities_world, on_frame=advance)


def searched(
    source: FlightSource,
    config: VehicleConfig,
    *,
    truth: Trajectory,
    velocities: Array,
    on_frame: Callable[[], None] = lambda: None,
) -> RecordedFlight:
    """Search a recording's images for features.

    Args:
        source: the recording.
        config: whose front end, and uncertainty of the rig, is used.
        truth: true poses.
        velocities: (N, 3) true velocity at each of them [m/s].
        on_frame: called when an image pair is done.

    Raises:
        UavVslamError: the recording has no start state.
    """
    if source.initial_state is None:
        raise UavVslamError(
            f"{source.vehicle}: the recording has no initial_state, whose covariance starts are drawn from"
        )
    frontend = make_frontend(source.rig, config.frontend, config.rig)

    def events() -> Iterator[ImuSample | StereoFeatures]:
        for event in source.iter_events():
            if not isinstance(event, StereoFrame):
                yield event
                continue
            yield features_of(event, frontend)
            on_frame()

    return RecordedFlight(source.vehicle, source.rig, source.initial_state, tuple(events()), truth, velocities)


def features_of(frame: StereoFrame, frontend: Frontend) -> StereoFeatures:
    """Search a pair; one that is refused has no points, as in `VehiclePipeline`."""
    try:
        return frontend.process(frame)
    except InvalidMessage:
        return StereoFeatures.empty(frame.stamp_ns)


@contextmanager
def _opened(recording: Path, vehicle: str | None) -> Iterator[BagFlight]:
    """Open a bag; an ASL folder becomes one for the time being."""
    with TemporaryDirectory() as scratch:
        bag = recording
        if (recording / "cam0").is_dir():
            bag = Path(scratch) / "bag"
            write_flights(bag, [read_euroc(recording).flight])
        names = [vehicle] if vehicle else vehicles([bag])
        if not names:
            raise BagError(f"bag {recording} holds no <vehicle>/left/image_raw; record or remap the images")
        yield open_flight(bag, names[0])
