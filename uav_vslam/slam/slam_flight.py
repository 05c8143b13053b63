# SPDX-License-Identifier: Apache-2.0
"""A flight from its start state on: the back end, and the monitors that watch over it frame by frame."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.increments import bridged, lacks_readings, unknown_motion_since
from uav_vslam.ins.preintegrator import dead_reckoned
from uav_vslam.ins.propagation import propagate
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.bias_steps import BiasStepMonitor
from uav_vslam.slam.clock_offset import WARNED_S, ClockOffsetMonitor
from uav_vslam.slam.epochs import crosses_epoch
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.noise_monitor import NoiseMonitor
from uav_vslam.slam.rig_monitor import RigMonitor
from uav_vslam.slam.rolling_shutter import exposed_at_once
from uav_vslam.slam.saved_map import SavedMap
from uav_vslam.slam.saved_map.archive import MapArchive
from uav_vslam.slam.shutter_monitor import ShutterMonitor
from uav_vslam.slam.start_watch import StartWatch
from uav_vslam.types import ImuIncrement, JointInformation, NavEstimate, StereoFeatures

UNKNOWN_ROTATION_RAD = 0.25  # 1 sigma about an axis: half a second without readings


@dataclass(frozen=True, slots=True)
class Timing:
    """When images are exposed.

    Attributes:
        readout_s: of the cameras, see `rig.readout_s` [s].
        time_offset_s: of their clock, see `TimeOffset` [s].
    """

    readout_s: float
    time_offset_s: float


class SlamFlight:
    """Processes frames, from the first one after a start state on.

    Attributes:
        backend: the present one.
        archive: all landmarks mapped, if they are kept.
        motion_lost: frames to which the motion was not known from the one before.
    """

    def __init__(
        self,
        initial: NavEstimate,
        *,
        rig: StereoRig,
        config: VehicleConfig,
        vehicle: str,
        session: int,
        archive: MapArchive | None,
        start_map: SavedMap | None,
        announced: bool,
        time_offset_s: float,
    ) -> None:
        """Begin at a start state.

        Args:
            initial: the start state.
            rig: calibration.
            config: of the vehicle.
            vehicle: its name.
            session: number of this start of it.
            archive: takes all landmarks; None if they are not kept.
            start_map: on which the start state depends, if any.
            announced: fusion knows the session; a new one it gets to know by the first frame's joint information.
            time_offset_s: of the cameras' clock, as it was measured [s].
        """
        self.backend = SlamBackend(initial, rig=rig, config=config, vehicle=vehicle, session=session)
        self.backend.expect_time_offset(time_offset_s)
        self.backend.keep_time_offset()
        self.archive = archive
        self.motion_lost = 0
        self._rig, self._config, self._start_map = rig, config, start_map
        self._start_watch = StartWatch(initial, config.start.method, config.imu)
        self._dead_reckoned = initial
        self._rig_monitor, self._noise_monitor = RigMonitor(config.rig), NoiseMonitor(config.imu)
        self._shutter = ShutterMonitor(config.rig)
        self._bias_steps = BiasStepMonitor()
        self._clock: ClockOffsetMonitor | None = None
        self._previous_ns: int | None = None
        self._is_announced = announced
        self._was_motion_unknown = self._was_recovered = False
        self._begun_offset_s = time_offset_s
        self._late_offset_s: float | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of checkpoints what makes them large: archived landmarks, and earlier states of the back end."""
        archive = None if self.archive is None else MapArchive(self.archive.origin)
        return self.__dict__ | {"archive": archive, "_bias_steps": BiasStepMonitor(), "_clock": None}

    @property
    def timing(self) -> Timing:
        """What the flight has begun with."""
        return Timing(self._config.rig.readout_s, self._begun_offset_s)

    @property
    def is_timing_confirmed(self) -> bool:
        """Whether readout and clock of the cameras have been measured, and are about as the flight has begun with."""
        is_known = not self._shutter.watching and self._clock is not None and self._clock.is_known
        return is_known and self._is_about_begun_offset(self.backend)

    @property
    def contradicting_timing(self) -> Timing | None:
        """The timing that was measured, once the readout is, if it is another than the flight has begun with.

        An offset of the clock counts if the filter was re-initialised before it was known: it is about another one.
        """
        if self._shutter.watching:
            return None
        if self._shutter.contradicting_s is not None:
            return dataclasses.replace(self.timing, readout_s=self._shutter.contradicting_s)
        if self._late_offset_s is not None:
            return dataclasses.replace(self.timing, time_offset_s=self._late_offset_s)
        return None

    def _is_about_begun_offset(self, backend: SlamBackend) -> bool:
        return abs(backend.time_offset_s - self._begun_offset_s) < WARNED_S

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config
        self.backend.configure(config)

    def process(self, features: StereoFeatures, increment: ImuIncrement | None) -> FrameOutput:
        """Process the next frame, with the motion up to it."""
        backend = self.backend
        increment = self._motion(backend, features.stamp_ns, increment)
        features, of_shutter = self._exposed_at_once(backend, features, increment)
        self._clock = self._clock or ClockOffsetMonitor(backend)
        report = backend.process(features, increment)
        backend, report, of_clock = self._clock.check(backend, features, increment, report, self._config)
        if of_clock and self._was_recovered:
            self._late_offset_s = backend.time_offset_s
        if self._begun_offset_s and self._is_about_begun_offset(backend):
            of_clock = ""  # the flight before has told it
        if backend is not self.backend:  # earlier ones are linearised about another offset
            self._bias_steps = BiasStepMonitor()
        if not backend.imu_fault:
            backend, report = self._bias_steps.check(backend, features, increment, report, self._config)
        self.backend = backend
        self._was_motion_unknown |= backend.imu_fault != ""
        of_start = ""
        if not report.recovery and not self._was_motion_unknown:  # what follows contradicts a correct start
            report, of_start = self._start_watch.check(backend, report, features, self._dead_reckoned)
        report, joint = self._with_joint(backend, report, features)
        if report.recovery:
            self._was_recovered = True
            self._start_watch.stop(report.pose.stamp_ns)
            self._bias_steps, self._clock = BiasStepMonitor(), ClockOffsetMonitor(backend)
        of_map = self._archive_landmarks(report, joint)
        noisy = self._noise_warnings(backend.track_sigma_px, increment)
        warnings = (*noisy, of_clock, of_shutter, of_start, of_map, self._warning(report))
        told = tuple(text for text in warnings if text)
        return FrameOutput(report, self._dead_reckoned, joint, increment, told, self._config.rig.readout_s)

    def _motion(self, backend: SlamBackend, stamp_ns: int, increment: ImuIncrement | None) -> ImuIncrement | None:
        """Return the motion from the estimate to a frame, unknown as far as no increment has it; None for none."""
        if increment is None and stamp_ns != backend.stamp_ns:
            self.motion_lost += 1
            increment = unknown_motion_since(backend.nav.state, stamp_ns, self._config.imu)
        if increment is None:
            return None
        # before the filter, which may fail: the baseline must not miss a step
        self._dead_reckoned = dead_reckoned(self._dead_reckoned, increment, self._config.imu)
        self._start_watch.add_motion(increment)
        self.motion_lost += increment.start_ns != backend.stamp_ns
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
        """Collect landmarks for the map; return why they are left out until a later epoch, empty if they are not."""
        if self.archive is None:
            return ""
        for sightings in (report.late_sightings, report.sightings):
            self.archive.count(sightings)
        try:
            if joint is not None:
                self.archive.add(joint)
        except FilterDivergence as error:
            return f"landmarks are left out of the map of this flight, unless a later epoch adds them: {error}"
        return ""

    def _noise_warnings(self, track_sigma_px: float, increment: ImuIncrement | None) -> list[str]:
        configured_px = self._config.backend.track_sigma_px
        found = [self._noise_monitor.add_tracks(track_sigma_px, configured_px=configured_px)]
        return found if increment is None else [*found, self._noise_monitor.add(increment)]

    def _exposed_at_once(
        self, backend: SlamBackend, features: StereoFeatures, increment: ImuIncrement | None
    ) -> tuple[StereoFeatures, str]:
        """Return what a global shutter would show of a frame, and a warning if that needs another readout."""
        before, readout_s = backend.nav.state, self._config.rig.readout_s
        if readout_s == 0.0 and not self._shutter.watching:
            return features, ""
        now = before if increment is None else propagate(before, increment, gravity=self._config.imu.gravity)
        at_once = exposed_at_once(features, now, increment, rig=self._rig, readout_s=readout_s)
        if increment is None or lacks_readings(increment):
            self._shutter.begin(features)
            return at_once, ""
        return at_once, self._shutter.add(features, before, now, increment, self._rig)

    def _warning(self, report: FrameReport) -> str:
        if report.recovery:
            return f"the filter was re-initialised: {report.recovery}"
        if self._was_motion_unknown or not self._start_watch.trusts(report.pose.stamp_ns):
            return ""  # an unknown motion, or a wrong start, contradicts a correct rig
        return self._rig_monitor.add(report)
