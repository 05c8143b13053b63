# SPDX-License-Identifier: Apache-2.0
"""The own-only SLAM of one vehicle, frame by frame: predict, associate, update, manage the map.

Nothing received over a network enters here.
"""

import copy
import dataclasses
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import ImuConfig, VehicleConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.filters import make_filter, past_poses
from uav_vslam.estimation.rig_belief import DisparityEstimate, TimeOffset
from uav_vslam.estimation.weighted_update import Innovation
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.preintegrator import advance
from uav_vslam.slam.disparity_judge import DisparityJudge
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.health import MIN_FEATURES, FilterHealth
from uav_vslam.slam.imu_fault import ImuFaultDetector
from uav_vslam.slam.landmark_map import LONG_FRAMES, LandmarkMap
from uav_vslam.slam.local_map import LocalMap
from uav_vslam.slam.map_matching import MapMatcher
from uav_vslam.slam.matches import Matches
from uav_vslam.slam.recovery import Fallbacks, reinitialised
from uav_vslam.slam.seen_motion import MotionFinder, Step
from uav_vslam.slam.track_noise import TrackNoise
from uav_vslam.slam.track_window import Present, TrackWindow
from uav_vslam.types import (
    NS_PER_S,
    ImuIncrement,
    JointInformation,
    NavEstimate,
    PoseEstimate,
    StereoFeatures,
)

SKIPPED_IDS = 100_000  # after a restart: more landmarks than are added between two checkpoints
LOST_SHARE = 0.1  # of the tracks of the frame before: if fewer go on, landmarks are found by their looks alone


@dataclass(slots=True)
class _Outcome:
    """What the filter has made of a frame, as far as it got; see `FrameReport` for what has the same name there.

    Attributes:
        matches: landmarks that corrected the state.
        known: landmarks and tracks that the frame could have shown.
        finished: tracks that it shows and that were used with it, to the end of their window.
        restart: where a recovery re-initialises the filter; None for the newest estimate.
    """

    known: int
    tracked: int
    renewed: int = 0
    finished: int = 0
    matches: Matches = field(default_factory=Matches.none)
    innovation: Innovation | None = None
    as_calibrated: NavEstimate | None = None
    doubting: NavEstimate | None = None
    rig_evidence: float = 0.0
    disparity: DisparityEstimate | None = None
    time_offset: TimeOffset | None = None
    closures: int = 0
    sightings: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    late_sightings: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    smoothed: PoseEstimate | None = None
    recovery: str = ""
    restart: NavEstimate | None = None

    @property
    def is_confirmed(self) -> bool:
        """Whether the image has corrected the estimate."""
        return not self.recovery and self.innovation is not None and self.innovation.dof > 0

    def give_up(self) -> None:
        """Forget what has corrected a state that is re-initialised."""
        self.matches, self.closures, self.as_calibrated = Matches.none(), 0, None
        self.sightings, self.finished = self.sightings[:0], 0


class SlamBackend:
    """A filter, its landmark map, and the frame loop."""

    def __init__(
        self,
        initial: NavEstimate,
        *,
        rig: StereoRig,
        config: VehicleConfig,
        vehicle: str,
        session: int = 1,
        matcher: MapMatcher | None = None,
    ) -> None:
        """Start at a state; `matcher` replaces the configured one."""
        self._rig, self._config = rig, config
        self._vehicle, self._session = vehicle, session
        self._matcher = matcher or MapMatcher(config.backend)
        self._map = LandmarkMap()
        self._frame = 0
        self._last_tracks = np.zeros(0, np.uint32)
        self._motion, self._imu_fault = MotionFinder(), ImuFaultDetector(config.imu.gravity)
        self._track_noise, self._flexing = TrackNoise(), config.rig.flexing
        self._present_rig = rig  # as the tracks correct it
        self._nav = initial
        self._fallbacks = Fallbacks(initial)
        self._increment: ImuIncrement | None = None  # the newest
        self._time_offset_s = 0.0  # of the cameras' clock, about which a filter begins
        self._reset(initial)

    @property
    def stamp_ns(self) -> int:
        """Time of the estimate [ns]."""
        return self._filter.nav.stamp_ns

    @property
    def nav(self) -> NavEstimate:
        """The newest estimate."""
        return self._nav

    @property
    def track_sigma_px(self) -> float:
        """Standard deviation of a tracked point's right pixel about its left one, as configured or as measured [px]."""
        configured = self._config.backend
        if not configured.track_noise_from_images:
            return configured.track_sigma_px
        return self._track_noise.sigma_px(configured.track_sigma_px)

    @property
    def landmarks(self) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        """Identifiers (N,) and positions (N, 3) [m] of the landmarks in the state."""
        return self._map.ids, self._filter.landmarks

    def skip_landmark_ids(self) -> None:
        """Leave out identifiers that may have been given to other landmarks."""
        self._map.skip_ids(SKIPPED_IDS)

    def to_replace(self, present: "SlamBackend", config: VehicleConfig) -> "SlamBackend":
        """Return a copy that is to use again what the present one has used since, and to replace it.

        It leaves out the identifiers that the present one has given to landmarks since.
        """
        backend = copy.deepcopy(self)
        backend.configure(config)
        backend.continue_ids(present)
        return backend

    def continue_ids(self, present: "SlamBackend") -> None:
        """Leave out the identifiers that another back end of the session has given to landmarks."""
        self._map.continue_ids(present._map)

    def set_imu(self, imu: ImuConfig) -> None:
        """Go on with another noise of the IMU."""
        self._config = dataclasses.replace(self._config, imu=imu)
        self._filter.imu = imu

    @property
    def time_offset_s(self) -> float:
        """Exposure minus stamp [s]."""
        return self._filter.rig_state.time_offset_s

    def expect_time_offset(self, mean_s: float) -> None:
        """Go on about another offset of the cameras' clock [s], as uncertain as before."""
        self._filter.expect_time_offset(mean_s)

    def keep_time_offset(self) -> None:
        """Begin about the present offset whenever the filter is re-initialised."""
        self._time_offset_s = self.time_offset_s

    def process(self, features: StereoFeatures, increment: ImuIncrement | None) -> FrameReport:
        """Predict to a frame and update with its features.

        A filter that is lost, or no longer positive definite, is re-initialised without landmarks, at its last
        estimate (propagated by the IMU if need be), with an inflated covariance.

        Args:
            features: stereo points of the frame.
            increment: motion since the estimate's stamp; None only for a frame with that same stamp.

        Raises:
            ValueError: the increment does not span estimate to frame.
        """
        self._check_joins(features.stamp_ns, increment)
        R_map_body = self.nav.state.T_map_body.R
        self._track_noise.add(features, self._present_rig)
        step = self._step(increment, features)
        self._increment, features = step.increment, step.features
        if increment is not None:
            self._fallbacks.propagate(increment, self._config.imu)
        outcome = self._estimate(step)
        if outcome.is_confirmed:
            self._fallbacks.confirm(self._nav)
        self._look_for_faults(outcome, step, increment, R_map_body)
        if outcome.recovery:
            outcome.give_up()
            self._recover(outcome.restart)
            if self._imu_fault.reason:  # the motion from here on is that of the tracks
                self._window.add_frame(self._filter, features)
        added = self._local_map.add(features, self._frame, matches=outcome.matches)
        self._frame += len(features) > 0  # a frame without features says nothing about landmarks
        return self._report(step, outcome, added)

    def _estimate(self, step: Step) -> _Outcome:
        """Move the filter to a frame and correct it; where it fails, propagate the estimate by the IMU alone."""
        increment, features, is_seen = step.increment, step.features, step.tracks > 0
        before = len(self._last_tracks)
        outcome = _Outcome(known=len(self._map), tracked=self._continued(features))
        self._filter.track_sigma_px = self.track_sigma_px
        try:
            if increment is not None:
                late = self._local_map.add_postponed(increment, self._frame)
                outcome.late_sightings = self._local_map.new_sightings(late)
                self._disparity_judge.before_prediction(self._filter, increment)
                self._filter.predict(increment)
            self._window.add_frame(self._filter, features)
            new_landmarks = partial(self._local_map.new_landmarks, frame=self._frame)
            outcome.finished = self._window.finish(
                self._filter, self._map, self._frame, new_landmarks, everything=is_seen
            )
            if features.tracks.any() and outcome.tracked < LOST_SHARE * before:
                self._frame += LONG_FRAMES  # all landmarks are as if long unseen
            outcome.matches, outcome.innovation, outcome.closures = self._local_map.correct(
                features, self._frame, by_landmarks=not is_seen
            )
            self._disparity_judge.after_update(self._filter, self._nav, by_tracks=self._window.has_frames)
            self._take_present(outcome, features)
            self._local_map.remove_surplus(self._frame)
            if not self._disparity_judge.awaits_evidence:
                outcome.rig_evidence = self._filter.rig_evidence()
            outcome.known = max(outcome.known, self._window.followed)
            outcome.renewed = self._window.renewed
            outcome.recovery = self._health.check(outcome.innovation, features=len(features), known=outcome.known)
        except (FilterDivergence, np.linalg.LinAlgError) as error:  # the latter from data association
            if increment is not None and self._nav.state.stamp_ns != features.stamp_ns:
                self._nav = advance(self._nav, increment, self._config.imu)
            outcome.recovery = str(error)
        return outcome

    def _look_for_faults(
        self, outcome: _Outcome, step: Step, increment: ImuIncrement | None, R_map_body: NDArray[np.float64]
    ) -> None:
        """Order a recovery if this frame shows that the rig vibrates, or that the IMU is faulty.

        Args:
            outcome: of the frame.
            step: what it was processed with; its motion may be that of the tracks.
            increment: the motion that the IMU measured.
            R_map_body: (3, 3) attitude at the frame before.
        """
        telling = min(len(step.features), outcome.known) - outcome.renewed
        missed = not outcome.is_confirmed and telling >= MIN_FEATURES
        if vibration := self._noticed_vibration():
            self._imu_fault = ImuFaultDetector(self._config.imu.gravity)  # images missed for another reason
            outcome.recovery, outcome.restart = vibration, self._fallbacks.unaided
        elif increment is not None and self._imu_fault.add(
            increment, R_map_body, coasted=missed, apart_rad=step.apart_rad
        ):
            imu, is_gyro_healthy = self._config.imu, self._imu_fault.is_gyro_healthy
            self._nav = self._fallbacks.without_readings(self._nav, imu, is_gyro_healthy=is_gyro_healthy)
            outcome.recovery = self._imu_fault.reason

    def _trusting(self, present: Present) -> Present:
        """Return an estimate of the present that trusts the calibration as long as that is not judged."""
        return dataclasses.replace(present, filter=self._disparity_judge.trusting(present.filter))

    def _take_present(self, outcome: _Outcome, features: StereoFeatures) -> None:
        """Set the estimate to that of the filter and its tracks together."""
        doubting = self._window.present(self._filter, self._map)
        present = self._trusting(doubting)
        if present.filter is not doubting.filter:
            outcome.doubting = doubting.filter.nav_estimate(as_calibrated=True)
        self._nav, self._present_rig = present.filter.nav_estimate(), present.filter.rig
        if present.innovation is not None and present.innovation.dof:  # refused tracks hide no landmarks
            outcome.innovation = present.innovation
        outcome.as_calibrated = present.filter.nav_estimate(as_calibrated=True)
        outcome.disparity, outcome.time_offset = present.filter.disparity, present.filter.time_offset
        of_landmarks = self._local_map.sightings(outcome.matches)
        outcome.sightings = np.vstack([of_landmarks, self._track_sightings(present, features)])
        outcome.smoothed = self._window.leaving(present.filter)

    def _report(self, step: Step, outcome: _Outcome, added: NDArray[np.intp]) -> FrameReport:
        """Report a frame from whose rows `added` landmarks were added."""
        associated = 0 if outcome.recovery else len(outcome.sightings) + step.tracks
        return FrameReport(
            pose=self._nav.pose,
            nav=self._nav,
            features=len(step.features),
            associated=associated,
            relocalised=outcome.matches.relocalised,
            innovation=outcome.innovation,
            landmarks=len(self._map),
            recovery=outcome.recovery,
            as_calibrated=outcome.as_calibrated,
            doubting=outcome.doubting,
            rig_evidence=outcome.rig_evidence,
            disparity=outcome.disparity,
            time_offset=outcome.time_offset,
            closures=outcome.closures,
            tracked=outcome.tracked,
            renewed=outcome.renewed,
            coasted=step.increment is not None and associated + outcome.finished == 0,
            gate_probability=self._config.backend.gate_probability,
            smoothed=outcome.smoothed,
            flexing=self._flexing,
            sightings=np.vstack([outcome.sightings, self._local_map.new_sightings(added)]),
            late_sightings=outcome.late_sightings,
        )

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config
        self._local_map.configure(config.backend)
        self._filter.sigma_px = config.backend.sigma_px
        self._window.configure(config.backend)

    def joint_information(self) -> JointInformation:
        """Return the estimate of pose and landmarks, points still tracked included, for the vehicle's own fusion."""
        window = self._window
        all_in_view = partial(self._local_map.all_in_view, frame=self._frame)
        present = self._trusting(window.present(self._filter, self._map, all_in_view))
        descriptors = [some for some in (self._map.descriptors, window.views.descriptors[present.rows]) if len(some)]
        return JointInformation(
            stamp_ns=self.stamp_ns,
            vehicle=self._vehicle,
            session=self._session,
            T_map_body=present.filter.nav.T_map_body,
            ids=np.concatenate([self._map.ids, window.identified(present.rows, self._map)]),
            positions=present.filter.landmarks.copy(),
            information=present.filter.pose_landmark_information(),
            descriptors=np.vstack(descriptors) if descriptors else np.zeros_like(self._map.descriptors),
        )

    def recovered(
        self, report: FrameReport, features: StereoFeatures, reason: str, *, start: NavEstimate | None = None
    ) -> FrameReport:
        """Re-initialise the filter after a frame that seemed good, and return what is left of its report.

        Args:
            report: of the frame.
            features: its points.
            reason: for the report.
            start: what to go on from, because the frames contradict the start state; None for an estimate that
                has lost its positive definiteness.
        """
        unaided = self._fallbacks.unaided
        self._recover(start)
        if start is not None:  # a vibration that shows next explains the frames as well: back to the start itself then
            self._fallbacks.unaided = unaided
        added = self._local_map.add(features, self._frame, matches=Matches.none())
        return dataclasses.replace(
            report,
            pose=self._nav.pose,
            nav=self._nav,
            associated=0,
            landmarks=len(self._map),
            recovery=reason,
            as_calibrated=None,
            closures=0,
            coasted=True,
            sightings=self._local_map.new_sightings(added),
        )

    def _noticed_vibration(self) -> str:
        """Count the rig as flexing from when its images show that it vibrates; return how, that once."""
        if self._flexing:
            return ""
        vibration_px = self._track_noise.vibration_px
        if vibration_px < self.track_sigma_px:
            return ""
        self._flexing = True
        return (
            "the cameras vibrate against each other, or are not exposed at the same time: the right points of an image "
            f"are off together, by {vibration_px:.2f} px rms; rig.flexing is taken for true from now on: set it"
        )

    @property
    def imu_fault(self) -> str:
        """Why the motion is taken from the images alone; empty without a fault of the IMU."""
        return self._imu_fault.reason

    def _recover(self, at: NavEstimate | None) -> None:
        """Re-initialise the filter at an estimate; None for the newest one with an inflated covariance."""
        self._reset(at or reinitialised(self._nav, since_s=self._since_start_s, imu=self._config.imu))
        if self._increment is not None:
            self._filter.ends(self._increment)

    @property
    def _since_start_s(self) -> float:
        """Time of the newest estimate since the filter was initialised [s]."""
        return (self._nav.state.stamp_ns - self._fallbacks.began_ns) / NS_PER_S

    def _reset(self, initial: NavEstimate) -> None:
        """Re-initialise the filter without landmarks; identifiers continue."""
        rig_config = dataclasses.replace(self._config.rig, flexing=self._flexing)
        config = dataclasses.replace(self._config, rig=rig_config)
        self._filter = make_filter(initial, rig=self._rig, config=config)
        self._map.remove(np.arange(len(self._map)))
        self._window = TrackWindow(past_poses(config), config.backend)
        self._local_map = LocalMap(
            self._map, self._matcher, slam_filter=self._filter, window=self._window, config=config.backend
        )
        self._filter.expect_time_offset(self._time_offset_s)
        self._health = FilterHealth()
        self._nav = initial
        self._fallbacks.begin(initial)
        self._disparity_judge = DisparityJudge()

    def _continued(self, features: StereoFeatures) -> int:
        """Return how many points continue a track of the frame before."""
        tracks = features.tracks[features.tracks != 0]
        continued = int(np.isin(tracks, self._last_tracks).sum())
        self._last_tracks = tracks
        return continued

    def _check_joins(self, stamp_ns: int, increment: ImuIncrement | None) -> None:
        if increment is None:
            if stamp_ns != self.stamp_ns:
                raise ValueError(f"frame at {stamp_ns} ns needs the motion since {self.stamp_ns} ns")
        elif (increment.start_ns, increment.stamp_ns) != (self.stamp_ns, stamp_ns):
            raise ValueError(
                f"increment {increment.start_ns} to {increment.stamp_ns} ns does not span the estimate at "
                f"{self.stamp_ns} ns to the frame at {stamp_ns} ns"
            )

    def _step(self, increment: ImuIncrement | None, features: StereoFeatures) -> Step:
        return self._motion.step(
            increment,
            features,
            self._filter.nav,
            rig=self._filter.rig,
            imu=self._config.imu,
            threshold_px=self._config.backend.pnp_px,
            imu_fault=self._imu_fault,
        )

    def _track_sightings(self, present: Present, features: StereoFeatures) -> NDArray[np.intp]:
        """Return (K, 2) identifier and feature row of the tracks that the present frame shows."""
        views = self._window.views
        rows = present.rows[views.seen[present.rows, -1]] if len(present.rows) else present.rows
        _, feature_rows, shown = np.intersect1d(features.tracks, views.tracks[rows], return_indices=True)
        return np.column_stack([self._window.identified(rows[shown], self._map), feature_rows])
