# SPDX-License-Identifier: Apache-2.0
"""The back end as a stage: features and increments in, processed frames out, once start state and rig are known.

The node `slam_backend` and the offline pipeline both run it, so their results are identical.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import FilterDivergence, MapError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.increments import bridged, lacks_readings, unknown_motion_since
from uav_vslam.ins.preintegrator import DeadReckoning
from uav_vslam.ins.propagation import propagate
from uav_vslam.ins.startup_buffer import MAX_UNCOVERED_S
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.bias_steps import BiasStepMonitor
from uav_vslam.slam.clock_offset import ClockOffsetMonitor
from uav_vslam.slam.epochs import crosses_epoch
from uav_vslam.slam.frame_queue import FrameQueue
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.in_flight_initializer import Frame, InFlightInitializer
from uav_vslam.slam.map_initializer import MapInitializer
from uav_vslam.slam.noise_monitor import NoiseMonitor
from uav_vslam.slam.rig_monitor import RigMonitor
from uav_vslam.slam.rolling_shutter import exposed_at_once
from uav_vslam.slam.saved_map import MapOrigin, Mapped, SavedMap, load_map
from uav_vslam.slam.saved_map.archive import MapArchive
from uav_vslam.slam.shutter_monitor import ShutterMonitor
from uav_vslam.slam.start_watch import StartWatch
from uav_vslam.types import (
    NS_PER_S,
    FrameQuality,
    ImuIncrement,
    JointInformation,
    NavEstimate,
    StereoFeatures,
)

MANY_UNPAIRED = 10  # recent frames without an increment of their stamp: no accident
UNKNOWN_ROTATION_RAD = 0.25  # 1 sigma about an axis: half a second without readings


@dataclass(frozen=True, slots=True)
class FrameOutput:
    """All outputs of a frame.

    Attributes:
        report: own-only SLAM.
        dead_reckoning: the uncorrected INS at the same stamp.
        joint: the estimate of pose and landmarks, at epochs only.
        increment: the motion since the frame before that the back end used; None at the start itself.
        warnings: problems for the user; normally none.
    """

    report: FrameReport
    dead_reckoning: NavEstimate
    joint: JointInformation | None
    increment: ImuIncrement | None
    warnings: tuple[str, ...] = ()

    @property
    def quality(self) -> FrameQuality:
        """How the frame went, judged without ground truth."""
        report, innovation = self.report, self.report.innovation
        offset, disparity = report.time_offset, report.disparity
        return FrameQuality(
            stamp_ns=report.pose.stamp_ns,
            features=report.features,
            tracked=report.tracked,
            associated=report.associated,
            downweighted=innovation.downweighted if innovation else 0,
            landmarks=report.landmarks,
            coasted=report.coasted,
            relocalised=report.relocalised,
            restarted=report.recovery != "",
            closures=report.closures,
            nis=innovation.nis if innovation else 0.0,
            dof=innovation.dof if innovation else 0,
            gate_probability=report.gate_probability,
            events=self.warnings,
            time_offset_s=offset.mean_s if offset else 0.0,
            time_offset_sigma_s=offset.sigma_s if offset else 0.0,
            disparity_error_px=disparity.mean_px if disparity else 0.0,
            disparity_error_sigma_px=disparity.sigma_px if disparity else 0.0,
        )


class SlamStage:
    """Pairs features with IMU increments, initialises in flight if configured, and runs `SlamBackend`.

    Attributes:
        rig: calibration; nothing is processed while it is None.
        initial: start state; None until given or found.
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
        self._config, self._vehicle, self._session = config, vehicle, session
        self._in_flight = config.start.searches
        self._queue = FrameQueue()
        self._search: InFlightInitializer | None = None
        self._backend: SlamBackend | None = None
        self._start_watch = StartWatch(config.start.method, config.imu)
        self._rig_monitor, self._noise_monitor = RigMonitor(config.rig), NoiseMonitor(config.imu)
        self._shutter = ShutterMonitor(config.rig.readout_s)
        self._bias_steps = BiasStepMonitor()
        self._clock: ClockOffsetMonitor | None = None
        self._dead_reckoning = DeadReckoning(config.imu)
        self._previous_ns: int | None = None
        self._start_warning = ""  # of the start state that was found
        self._is_announced = True  # fusion knows the session; a new one it gets to know by joint information
        self._was_motion_unknown = False
        self._motion_lost = self._start_unreachable = 0
        self._archive = self._new_archive() if keep_map else None
        self._map = loaded
        if loaded is None and config.start.map:
            self._map = self._checked(load_map(config.start.map))
        self.rig: StereoRig | None = None
        self.initial: NavEstimate | None = None

    def _new_archive(self) -> MapArchive:
        return MapArchive(self._origin(self._session))

    def _origin(self, session: int) -> MapOrigin:
        return MapOrigin(self._vehicle, session, self._config.frames.map_of(self._vehicle), stamp_ns=0)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of checkpoints what makes them large: archived landmarks, and earlier states of the back end."""
        archive = None if self._archive is None else self._new_archive()
        return self.__dict__ | {"_archive": archive, "_bias_steps": BiasStepMonitor(), "_clock": None}

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
            "frame_lost": self._queue.lost,
            "without_motion": self._queue.without_motion,
            "motion_lost": self._motion_lost,
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
        return self._backend.imu_fault if self._backend is not None else ""

    @property
    def session(self) -> int:
        """Number of this start of the vehicle."""
        return self._session

    @property
    def stamp_ns(self) -> int | None:
        """Time of the estimate [ns]; None before the first frame."""
        return self._backend.stamp_ns if self._backend is not None else None

    @property
    def nav(self) -> NavEstimate | None:
        """The newest estimate; None before the first frame."""
        return self._backend.nav if self._backend is not None else None

    def restarted(self, session: int, initial: NavEstimate | None = None) -> "SlamStage":
        """Return a stage that starts again, with the same settings, rig and map to start in; it reads no file.

        Args:
            session: its number, above this one's.
            initial: start state; None to wait for one, or to find one.
        """
        stage = SlamStage(
            self._config,
            vehicle=self._vehicle,
            session=session,
            keep_map=self._archive is not None,
            loaded=self._map,
        )
        stage.rig, stage._is_announced = self.rig, False
        if initial is not None:
            stage.start(initial)
        return stage

    def resume(self) -> None:
        """Go on after a restart: landmarks since the checkpoint may be known to peers, so identifiers are skipped."""
        if self._backend is not None:
            self._backend.skip_landmark_ids()

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config
        for part in (self._search, self._backend):
            if part is not None:
                part.configure(config)

    def start(self, initial: NavEstimate) -> None:
        """Set the start state; a later one counts only before the first frame, and not in flight."""
        if self.initial is None or (self._backend is None and not self._in_flight):
            self.initial = initial
            self._dead_reckoning.start(initial)
            self._start_watch.start(initial)
            if self._queue.start_ns is None or not self._in_flight:
                self._queue.start_ns = initial.state.stamp_ns

    def mapped(self) -> Mapped:
        """Return all landmarks mapped until the last epoch; none without `keep_map`."""
        if self._archive is None:
            return Mapped(self._origin(self._session))
        mapped = self._archive.mapped()
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
        self._queue.add_features(features)

    def add_increment(self, increment: ImuIncrement) -> None:
        """Add the motion between two images."""
        if self._in_flight and self._queue.start_ns is None:
            self._queue.start_ns = increment.start_ns
        self._queue.add_increment(increment)

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
        if self._backend is not None or increment is None or self.initial is None:
            return True
        unknown_s = (increment.start_ns - self.initial.state.stamp_ns) / NS_PER_S
        self._start_unreachable += unknown_s > MAX_UNCOVERED_S
        return unknown_s <= MAX_UNCOVERED_S

    def _initializer(self, rig: StereoRig) -> InFlightInitializer:
        if self._config.start.method != "map":
            return InFlightInitializer(rig, self._config)
        return MapInitializer(rig, self._config, self._map or SavedMap(self._origin(0)))

    def _process(self, rig: StereoRig, features: StereoFeatures, increment: ImuIncrement | None) -> FrameOutput:
        if self._backend is None:
            assert self.initial is not None
            self._backend = SlamBackend(
                self.initial, rig=rig, config=self._config, vehicle=self._vehicle, session=self._session
            )
        backend = self._backend
        increment = self._motion(backend, features.stamp_ns, increment)
        features, of_shutter = self._exposed_at_once(rig, backend, features, increment)
        self._clock = self._clock or ClockOffsetMonitor(backend)
        report = backend.process(features, increment)
        backend, report, of_clock = self._clock.check(backend, features, increment, report, self._config)
        if backend is not self._backend:  # earlier ones are linearised about another offset
            self._bias_steps = BiasStepMonitor()
        if not backend.imu_fault:
            backend, report = self._bias_steps.check(backend, features, increment, report, self._config)
        self._backend = backend
        self._was_motion_unknown |= backend.imu_fault != ""
        dead_reckoned, of_start = self._dead_reckoning.estimate, ""
        assert dead_reckoned is not None  # started with the back end
        if not report.recovery and not self._was_motion_unknown:  # what follows contradicts a correct start
            report, of_start = self._start_watch.check(backend, report, features, dead_reckoned)
        report, joint = self._with_joint(backend, report, features)
        if report.recovery:
            self._start_watch.stop(report.pose.stamp_ns)
            self._bias_steps, self._clock = BiasStepMonitor(), ClockOffsetMonitor(backend)
        of_map = self._archive_landmarks(report, joint)
        noisy = self._noise_warnings(backend.track_sigma_px, increment)
        warnings = (self._start_warning, *noisy, of_clock, of_shutter, of_start, of_map, self._warning(report))
        self._start_warning = ""
        return FrameOutput(report, dead_reckoned, joint, increment, tuple(text for text in warnings if text))

    def _motion(self, backend: SlamBackend, stamp_ns: int, increment: ImuIncrement | None) -> ImuIncrement | None:
        """Return the motion from the estimate to a frame, unknown as far as no increment has it; None for none."""
        if increment is None and stamp_ns != backend.stamp_ns:
            self._motion_lost += 1
            increment = unknown_motion_since(backend.nav.state, stamp_ns, self._config.imu)
        if increment is None:
            return None
        # before the filter, which may fail: the baseline must not miss a step
        self._dead_reckoning.add(increment)
        self._start_watch.add_motion(increment)
        self._motion_lost += increment.start_ns != backend.stamp_ns
        increment = bridged(increment, backend.stamp_ns, self._config.imu)
        self._was_motion_unknown |= bool(increment.covariance[0, 0] > UNKNOWN_ROTATION_RAD**2)
        if lacks_readings(increment):  # the velocity is corrected for what happened in the gap
            self._start_watch.stop(increment.start_ns)
            self._bias_steps = BiasStepMonitor()
        return increment

    def _with_joint(
        self, backend: SlamBackend, report: FrameReport, features: StereoFeatures
    ) -> tuple[FrameReport, JointInformation | None]:
        """Return a frame's report, and at epochs and a session's first frame the joint information.

        Where the filter has lost its positive definiteness, it is re-initialised, and the report says so.
        """
        at_epoch = crosses_epoch(self._previous_ns, features.stamp_ns, self._config.fusion.epoch_s)
        self._previous_ns = features.stamp_ns
        if self._is_announced and not at_epoch:
            return report, None
        try:
            joint = self._joint_information(backend)
        except FilterDivergence as error:
            report = backend.recovered(report, features, str(error))
            joint = self._joint_information(backend)
        self._is_announced = True
        return report, joint

    def _joint_information(self, backend: SlamBackend) -> JointInformation:
        joint, start_map = backend.joint_information(), self._start_map
        if start_map is None:
            return joint
        return dataclasses.replace(joint, prior_id=start_map.hash, other_sources=start_map.origin.sources)

    def _archive_landmarks(self, report: FrameReport, joint: JointInformation | None) -> str:
        """Collect landmarks for the map; return why they are left out, empty if they are not."""
        if self._archive is None:
            return ""
        for sightings in (report.late_sightings, report.sightings):
            self._archive.count(sightings)
        try:
            if joint is not None:
                self._archive.add(joint)
        except FilterDivergence as error:
            return f"landmarks are missing in the map of this flight: {error}"
        return ""

    def _noise_warnings(self, track_sigma_px: float, increment: ImuIncrement | None) -> list[str]:
        configured_px = self._config.backend.track_sigma_px
        found = [self._noise_monitor.add_tracks(track_sigma_px, configured_px=configured_px)]
        return found if increment is None else [*found, self._noise_monitor.add(increment)]

    def _exposed_at_once(
        self, rig: StereoRig, backend: SlamBackend, features: StereoFeatures, increment: ImuIncrement | None
    ) -> tuple[StereoFeatures, str]:
        """Return what a global shutter would show of a frame, and a warning if that needs another readout."""
        before, readout_s = backend.nav.state, self._config.rig.readout_s
        if readout_s == 0.0 and not self._shutter.watching:
            return features, ""
        now = before if increment is None else propagate(before, increment, gravity=self._config.imu.gravity)
        at_once = exposed_at_once(features, now, increment, rig=rig, readout_s=readout_s)
        if increment is None or lacks_readings(increment) or backend.imu_fault:
            self._shutter.begin(features)
            return at_once, ""
        return at_once, self._shutter.add(features, before, now, increment, rig)

    def _warning(self, report: FrameReport) -> str:
        if report.recovery:
            return f"the filter was re-initialised: {report.recovery}"
        if self._was_motion_unknown or not self._start_watch.trusts(report.pose.stamp_ns):
            return ""  # an unknown motion, or a wrong start, contradicts a correct rig
        return self._rig_monitor.add(report)
