# SPDX-License-Identifier: Apache-2.0
"""The back end as a stage: features and increments in, processed frames out, once start state and rig are known.

The node `slam_backend` and the offline pipeline both run it, so their results are identical.
"""

import dataclasses
from collections.abc import Iterator

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import MapError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.startup_buffer import MAX_UNCOVERED_S
from uav_vslam.slam.first_frames import FirstFrames
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_queue import Frame, FrameQueue
from uav_vslam.slam.in_flight_initializer import InFlightInitializer
from uav_vslam.slam.map_initializer import MapInitializer
from uav_vslam.slam.saved_map import MapOrigin, Mapped, SavedMap, load_map
from uav_vslam.slam.saved_map.archive import MapArchive
from uav_vslam.slam.slam_flight import SlamFlight, Timing
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, StereoFeatures

MANY_UNPAIRED = 10  # recent frames without an increment of their stamp: no accident


class SlamStage:
    """Pairs features with IMU increments, initialises in flight if configured, and runs a `SlamFlight`.

    Attributes:
        rig: calibration; nothing is processed while it is None.
        initial: start state; None until given or found.
        session: number of this start of the vehicle.
    """

    def __init__(
        self,
        config: VehicleConfig,
        *,
        vehicle: str,
        session: int = 1,
        keep_map: bool = False,
        loaded: SavedMap | None = None,
    ) -> None:
        """Wait for start state and rig.

        Args:
            config: of the vehicle.
            vehicle: its name.
            session: number of this start of it.
            keep_map: all landmarks are collected for `mapped`.
            loaded: a map that has been read already; None: that of `start.map`, if it is set.

        Raises:
            MapError: the map of `start.map` can't be read, or is empty and to be started in.
        """
        self._config, self._vehicle, self.session = config, vehicle, session
        self._queue = FrameQueue()
        self._search: InFlightInitializer | None = None
        self._flight: SlamFlight | None = None  # begins with the first frame
        self._first_frames = FirstFrames()
        self._start_warning = ""  # of the start state that was found
        self._is_announced = True  # fusion knows the session; a new one it gets to know by joint information
        self._start_unreachable = 0
        self._keep_map = keep_map
        self._map = loaded
        if loaded is None and config.start.map:
            self._map = self._checked(load_map(config.start.map))
        self.rig: StereoRig | None = None
        self.initial: NavEstimate | None = None

    def _origin(self, session: int) -> MapOrigin:
        return MapOrigin(self._vehicle, session, self._config.frames.map_of(self._vehicle), stamp_ns=0)

    @property
    def missing_start(self) -> str:
        """Reason for the missing start state; empty once there is one."""
        if self.initial is not None:
            return ""
        if self._config.start.method == "map" and self._map is None:
            return "no map is loaded; set start.map"
        return self._search.reason if self._search else "none was received"

    @property
    def dropped(self) -> dict[str, int]:
        """Counts of frames not processed and of missing motion, by reason.

        Frames buffered for a start state count as before the start.
        """
        before_start = self._queue.before_start
        if self._search is not None:
            before_start += self._search.dropped + (self._search.waiting if self.initial is None else 0)
        return {
            "before_start": before_start,
            "before_rig": self._queue.before_rig,
            "frame_lost": self._queue.lost,
            "without_motion": self._queue.without_motion,
            "motion_lost": self._flight.motion_lost if self._flight is not None else 0,
            "motion_before_start": self._queue.motion_before_start,
            "motion_before_rig": self._queue.motion_before_rig,
            "motion_refused": self._queue.motion_refused,
            "start_too_old": self._start_unreachable,
        }

    @property
    def unpaired(self) -> str:
        """Why most recent frames had no increment of their stamp; empty while they have."""
        if self._queue.unpaired < MANY_UNPAIRED:
            return ""
        return (
            f"most frames are dropped, stamped {self._queue.apart_ns / 1e6:+.3f} ms from the increments, which end at "
            "camera_info's stamps: each image needs a camera_info of its own stamp"
        )

    @property
    def imu_fault(self) -> str:
        """Why the motion is taken from the images alone; empty without a fault of the IMU."""
        return self._flight.backend.imu_fault if self._flight is not None else ""

    @property
    def stamp_ns(self) -> int | None:
        """Time of the estimate [ns]; None before the first frame."""
        return self._flight.backend.stamp_ns if self._flight is not None else None

    @property
    def nav(self) -> NavEstimate | None:
        """The newest estimate; None before the first frame."""
        return self._flight.backend.nav if self._flight is not None else None

    def restarted(self, session: int, initial: NavEstimate | None) -> "SlamStage":
        """Return a stage that starts again, with the same settings, rig and map to start in; it reads no file.

        Args:
            session: its number, above this one's.
            initial: start state; None to wait for one, or to find one.
        """
        stage = SlamStage(
            self._config,
            vehicle=self._vehicle,
            session=session,
            keep_map=self._keep_map,
            loaded=self._map,
        )
        stage.rig, stage._is_announced = self.rig, False
        if initial is not None:
            stage.start(initial)
        return stage

    def resume(self) -> None:
        """Go on after a restart: landmarks since the checkpoint may be known to peers, so identifiers are skipped."""
        if self._flight is not None:
            self._flight.backend.skip_landmark_ids()

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config = _with_readout(config, self._config.rig.readout_s)  # which may have been measured
        for part in (self._search, self._flight):
            if part is not None:
                part.configure(config)

    def start(self, initial: NavEstimate) -> None:
        """Set the start state; a later one counts only before the first frame, and not in flight."""
        if self.initial is None or (self._flight is None and not self._config.start.searches):
            self.initial = initial
            if self._queue.start_ns is None or not self._config.start.searches:
                self._queue.start_ns = initial.state.stamp_ns

    @property
    def loaded_map(self) -> SavedMap | None:
        """The map that was loaded; None if none was."""
        return self._map

    def mapped(self) -> Mapped:
        """Return all landmarks mapped until the last epoch; none without `keep_map`."""
        if self._flight is None or self._flight.archive is None:
            return Mapped(self._origin(self.session))
        mapped = self._flight.archive.mapped()
        others = self._start_map.origin.sources if self._start_map else ()
        return dataclasses.replace(mapped, origin=dataclasses.replace(mapped.origin, other_sources=others))

    def load_map(self, saved: SavedMap) -> None:
        """Take over a map to start in.

        Raises:
            MapError: the vehicle has started already, or does not start in a map, or the map is empty.
        """
        if self._config.start.method != "map":
            raise MapError(f"start.method is {self._config.start.method}; a map is loaded to start in by method map")
        if self.initial is not None:
            raise MapError("the vehicle has its start state already; load the map before the flight")
        self._map, self._search = self._checked(saved), None

    def _checked(self, saved: SavedMap) -> SavedMap:
        """Return a map; refuse an empty one to start in, in which the vehicle would search for good.

        Raises:
            MapError: it has no landmarks.
        """
        if self._config.start.method == "map" and not len(saved):
            raise MapError(f"the map of {saved.origin.vehicle} has no landmarks to start in; save it in flight")
        return saved

    @property
    def _start_map(self) -> SavedMap | None:
        """The map that the start state depends on."""
        return self._map if self._config.start.method == "map" else None

    def add_features(self, features: StereoFeatures) -> None:
        """Add a frame's features."""
        self._queue.add_features(features, has_rig=self.rig is not None)

    def add_increment(self, increment: ImuIncrement) -> None:
        """Add the motion between two images."""
        if self._config.start.searches and self._queue.start_ns is None:
            self._queue.start_ns = increment.start_ns
        self._queue.add_increment(increment, has_rig=self.rig is not None)

    def run(self) -> Iterator[FrameOutput]:
        """Process every frame whose features and increment have both arrived."""
        if self.rig is None:
            return
        while (frame := self._queue.pop()) is not None:
            for ready in self._from_start_on(frame, self.rig):
                yield self._process(self.rig, *ready)

    def _from_start_on(self, frame: Frame, rig: StereoRig) -> list[Frame]:
        """Return the frame; without a start state buffer it, and return all buffered frames once there is one."""
        if self.initial is not None:
            return [frame] if self._is_reachable(frame) else []
        if self._search is None:
            self._search = self._initializer(rig)
        found = self._search.add(*frame)
        if found is None:
            return []
        self.start(found.initial)
        self._start_warning = found.warning
        return found.frames

    def _is_reachable(self, frame: Frame) -> bool:
        """Return whether the motion from the start state to the first frame is known; otherwise the frame is dropped.

        A back end that comes late, or is restarted without a checkpoint, must not take the take-off state for its own.
        """
        increment = frame[1]
        if self._flight is not None or increment is None or self.initial is None:
            return True
        unknown_s = (increment.start_ns - self.initial.state.stamp_ns) / NS_PER_S
        self._start_unreachable += unknown_s > MAX_UNCOVERED_S
        return unknown_s <= MAX_UNCOVERED_S

    def _initializer(self, rig: StereoRig) -> InFlightInitializer:
        if self._config.start.method != "map":
            return InFlightInitializer(rig, self._config)
        return MapInitializer(rig, self._config, self._map or SavedMap(self._origin(0)))

    def _process(self, rig: StereoRig, features: StereoFeatures, increment: ImuIncrement | None) -> FrameOutput:
        if self._flight is None:
            assert self.initial is not None
            self._flight = self._new_flight(self.initial, rig, self._config)
        output = self._flight.process(features, increment)
        flight, output = self._first_frames.add(features, increment, self._flight, output, self._begun_again)
        if flight is not self._flight:
            self._flight, self._config = flight, _with_readout(self._config, output.readout_s)
        if self._start_warning:
            output = dataclasses.replace(output, warnings=(self._start_warning, *output.warnings))
            self._start_warning = ""
        return output

    def _begun_again(self, timing: Timing) -> SlamFlight:
        """Return a flight with another timing; the session is known by the frames before it."""
        assert self.initial is not None
        assert self.rig is not None  # there is a flight
        self._is_announced = True
        config = _with_readout(self._config, timing.readout_s)
        return self._new_flight(self.initial, self.rig, config, time_offset_s=timing.time_offset_s)

    def _new_flight(
        self, initial: NavEstimate, rig: StereoRig, config: VehicleConfig, *, time_offset_s: float = 0.0
    ) -> SlamFlight:
        return SlamFlight(
            initial,
            rig=rig,
            config=config,
            vehicle=self._vehicle,
            session=self.session,
            archive=MapArchive(self._origin(self.session)) if self._keep_map else None,
            start_map=self._start_map,
            announced=self._is_announced,
            time_offset_s=time_offset_s,
        )


def _with_readout(config: VehicleConfig, readout_s: float) -> VehicleConfig:
    return dataclasses.replace(config, rig=dataclasses.replace(config.rig, readout_s=readout_s))
