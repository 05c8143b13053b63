# SPDX-License-Identifier: Apache-2.0
"""Start state of a vehicle in flight, from gravity and stereo odometry; its position and yaw define the map.

The first usable frame is the map's origin with yaw 0. Frames are buffered until a window of them agrees on a motion;
then the filter starts at the window's first frame and processes them all. The motion is found from the frames that see
points of the first one: all of the window or, low and fast, its beginning. Its velocity and tilt are the mean of a
prior wider than their error, so that these frames hardly count twice. But too wide a prior lets the filter follow the
first frames' noise by degrees of tilt: it linearises there and is over-confident for the rest of the flight.

So `imu.gyro_bias_sigma` counts, unless the frames contradict it: a bias far beyond it is found from them.
"""

import bisect
import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.config import ImuConfig, VehicleConfig
from uav_vslam.errors import FilterDivergence, UavVslamError
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.alignment import levelled, unlike_gravity
from uav_vslam.ins.increments import compose
from uav_vslam.slam.frame_queue import Frame
from uav_vslam.slam.rolling_shutter import pixels_at_once
from uav_vslam.slam.visual_inertial_alignment import GRAVITY, GYRO_BIAS, VELOCITY, Alignment, View, align
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, NavState, StereoFeatures
from uav_vslam.vision.matching.nn_ratio import match_descriptors

WINDOW_S = 1.0  # of the frames that the start is found from
MAX_TILT_SIGMA_DEG = 3.0  # frames that leave roll and pitch less certain are not used
MIN_MATCHES = 6  # of a view with the first frame
MIN_VIEWS = 2  # later frames that see the first one's points, for velocity and gravity (6 unknowns)
MAX_VIEWS = 8  # more views in the window add little
MIN_AGREEING = 0.5  # share of the matches that must fit one motion
PRIOR_PER_SIGMA = 2.0  # prior sigma over the window's own: of tilt, mostly the accelerometer's bias, and a found bias
ANY_GYRO_BIAS = 0.1  # [rad/s] prior sigma of a bias that contradicts the configured one
MOST_BIAS_CHI2 = float(chdtri(3, 1e-4))  # of a bias that its configured sigma allows; clocks 5 ms apart reach 18
MAX_BIAS_TURN_RAD = 0.1  # rotation by the gyro bias over the window; increments are corrected to first order only


class InsufficientEvidence(UavVslamError):
    """A window of frames does not determine the motion; the text says why."""


@dataclass(frozen=True, slots=True)
class Start:
    """A start state and the frames to process from it.

    Attributes:
        initial: state at the first of the frames.
        frames: all buffered frames with the increment up to each; None for the first.
        warning: what the user is to check; normally empty.
    """

    initial: NavEstimate
    frames: list[Frame]
    warning: str = ""


@dataclass(frozen=True, slots=True)
class Window:
    """Frames that agree on a motion.

    Attributes:
        first: the first frame.
        usable: (N,) rows of its features that triangulate.
        pixels: (N, 4) theirs [px].
        views: them in later frames.
        motion: at the first frame.
        imu: that it was found with: as configured, or with any gyro bias.
        sigma_tilt_rad: largest standard deviation of the motion's horizontal axes [rad].
    """

    first: StereoFeatures
    usable: NDArray[np.intp]
    pixels: NDArray[np.float64]
    views: list[View]
    motion: Alignment
    imu: ImuConfig
    sigma_tilt_rad: float


class InFlightInitializer:
    """Slides a window over the frames until one determines the motion.

    Attributes:
        reason: why there is no start yet.
        dropped: frames dropped as the window moved.
    """

    def __init__(self, rig: StereoRig, config: VehicleConfig) -> None:
        self._rig, self._config = rig, config
        self._buffer: list[Frame] = []
        self.reason = "no frame has arrived"
        self.dropped = 0

    def configure(self, config: VehicleConfig) -> None:
        """Go on with live settings that have changed."""
        self._config = config

    @property
    def waiting(self) -> int:
        """Buffered frames."""
        return len(self._buffer)

    def add(self, features: StereoFeatures, increment: ImuIncrement | None) -> Start | None:
        """Add a frame with the increment since the previous one; return the start once it is found."""
        if increment is None or not self._joins(increment):
            self.dropped += len(self._buffer)
            self._buffer = [(features, None)]
        else:
            self._buffer.append((features, increment))
        while self._window_is_full():
            try:
                return self._start()
            except InsufficientEvidence as error:
                self.reason = str(error)
            except (FilterDivergence, np.linalg.LinAlgError) as error:
                self.reason = f"the frames show no motion that can be computed: {error}"
            self._slide()
        if self.dropped == 0:
            span_s = self._span_ns / NS_PER_S
            self.reason = f"{len(self._buffer)} frames over {span_s:.1f} s have arrived, not yet enough"
        return None

    def _joins(self, increment: ImuIncrement) -> bool:
        return bool(self._buffer) and increment.start_ns == self._buffer[-1][0].stamp_ns

    @property
    def _span_ns(self) -> int:
        return self._buffer[-1][0].stamp_ns - self._buffer[0][0].stamp_ns

    def _window_is_full(self) -> bool:
        return len(self._buffer) > MIN_VIEWS and self._span_ns >= WINDOW_S * NS_PER_S

    def _slide(self) -> None:
        self.dropped += 1
        self._buffer = [(features, None if k == 0 else step) for k, (features, step) in enumerate(self._buffer[1:])]

    def _start(self) -> Start:
        """Return the start that the window determines.

        Raises:
            InsufficientEvidence: it does not.
        """
        window = self._window()
        return Start(self._start_state(window), self._buffer, self._warning(window))

    def _window(self) -> Window:
        """Return the window's first points and its motion."""
        first = self._buffer[0][0]
        shown = self._pixels(0)
        usable = np.flatnonzero(np.isfinite(self._rig.triangulate(shown)).all(axis=1))
        pixels, views = shown[usable], self._views(first.descriptors[usable])
        gained = sum(float(np.linalg.norm(view.motion.delta_v)) for view in views)
        if unlike := unlike_gravity(gained / sum(view.motion.dt_s for view in views), self._config.imu):
            raise InsufficientEvidence(unlike)
        found, imu, sigma_tilt_rad = self._motion(pixels, views)
        self._validate(found, views)
        return Window(first, usable, pixels, views, found, imu, sigma_tilt_rad)

    def _motion(self, pixels: NDArray[np.float64], views: list[View]) -> tuple[Alignment, ImuConfig, float]:
        """Return the motion, the noise that it was found with, and the standard deviation of its tilt [rad].

        Frames over a short time cannot tell a delay of the exposures from tilt. They are taken for exposed at their
        stamps, and leave the tilt as uncertain as is allowed.
        """
        found, imu = self._aligned(pixels, views, self._config.rig.time_offset_sigma_s)
        sigma, most = self._sigma_tilt_rad(found), float(np.deg2rad(MAX_TILT_SIGMA_DEG))
        if sigma > most:
            found, imu = self._aligned(pixels, views, 0.0)
            sigma = max(self._sigma_tilt_rad(found), most)
        return found, imu, sigma

    def _aligned(
        self, pixels: NDArray[np.float64], views: list[View], delay_sigma_s: float
    ) -> tuple[Alignment, ImuConfig]:
        """Return the motion, and the noise that it was found with: any gyro bias where that contradicts its spread."""
        imu = self._config.imu
        noise = {"sigma_px": self._config.backend.sigma_px, "delay_sigma_s": delay_sigma_s}
        free = dataclasses.replace(imu, gyro_bias_sigma=ANY_GYRO_BIAS)
        found = align(self._rig, pixels, views, imu=free, **noise)
        expected = found.covariance[GYRO_BIAS, GYRO_BIAS] + imu.gyro_bias_sigma**2 * np.eye(3)
        if found.gyro_bias @ np.linalg.solve(expected, found.gyro_bias) > MOST_BIAS_CHI2:
            return found, free
        return align(self._rig, pixels, views, imu=imu, **noise), imu

    def _is_bias_expected(self, window: Window) -> bool:
        return window.imu == self._config.imu

    def _warning(self, window: Window) -> str:
        if self._is_bias_expected(window):
            return ""
        bias, sigma = float(np.linalg.norm(window.motion.gyro_bias)), self._config.imu.gyro_bias_sigma
        return (
            f"the gyroscope's bias is {bias:.2g} rad/s by the first frames, far beyond imu.gyro_bias_sigma, "
            f"{sigma:.2g} rad/s; the start allows for it: set imu.gyro_bias_sigma, or calibrate the gyroscope"
        )

    def _start_state(self, window: Window) -> NavEstimate:
        """Return the state at a window's first frame."""
        imu, found = window.imu, window.motion
        bias_sigma = imu.gyro_bias_sigma
        if not self._is_bias_expected(window):
            bias_sigma = PRIOR_PER_SIGMA * _largest_sigma(found, GYRO_BIAS)
        return levelled(
            window.first.stamp_ns,
            up_body=-found.gravity,
            v_body=found.velocity,
            gyro_bias=found.gyro_bias,
            sigma_velocity=self._config.start.velocity_sigma,
            sigma_tilt=PRIOR_PER_SIGMA * window.sigma_tilt_rad,
            sigma_gyro_bias=bias_sigma,
            sigma_accel_bias=imu.accel_bias_sigma,
        )

    def _sigma_tilt_rad(self, found: Alignment) -> float:
        """Return the largest standard deviation of a horizontal axis [rad]."""
        return _largest_sigma(found, GRAVITY) / self._config.imu.gravity

    def _views(self, descriptors: NDArray[np.uint8]) -> list[View]:
        """Return the first frame's points as seen in later frames, spread over the time that they are in view."""

        @functools.cache
        def matches(k: int) -> NDArray[np.intp]:
            return match_descriptors(descriptors, self._buffer[k][0].descriptors, self._config.frontend.ratio)

        def is_lost(k: int) -> bool:
            return len(matches(k)) < MIN_MATCHES

        last = newest = len(self._buffer) - 1
        if is_lost(newest):
            last = max(bisect.bisect_left(range(1, newest), True, key=is_lost), MIN_VIEWS)
        chosen = set(np.linspace(1, last, MAX_VIEWS).round().astype(int).tolist())
        views: list[View] = []
        motion: ImuIncrement | None = None  # since the previous view
        for k, (_, step) in enumerate(self._buffer[1 : last + 1], start=1):
            assert step is not None
            motion = step if motion is None else compose(motion, step)
            if k in chosen and not is_lost(k):
                views.append(View(motion, matches(k)[:, 0], self._pixels(k)[matches(k)[:, 1]]))
                motion = None
        if len(views) < MIN_VIEWS:
            counts = ", ".join(str(len(matches(k))) for k in sorted(chosen))
            raise InsufficientEvidence(
                f"of {len(descriptors)} points only {counts} are matched in the next frames; {MIN_VIEWS} frames with "
                f"{MIN_MATCHES} are needed: take images more often, fly slower or higher, or over richer ground"
            )
        return views

    def _pixels(self, k: int) -> NDArray[np.float64]:
        """Return the (N, 4) pixels of a frame, of a rolling shutter without what the vehicle turns meanwhile.

        How it moves is not known yet: the velocity that is found contains what that does, half a percent at 20 ms.
        """
        features, step = self._buffer[k]
        pixels, readout_s = features.pixels.astype(float), self._config.rig.readout_s
        if readout_s == 0.0:
            return pixels
        still = NavState(features.stamp_ns, Pose.identity(), *np.zeros((3, 3)))
        after = self._buffer[1][1]  # the first frame has no motion before it
        assert after is not None
        turning = Turning.at_start(after, still) if step is None else Turning.at_end(step, still)
        return pixels_at_once(pixels, still, turning, rig=self._rig, readout_s=readout_s)

    def _validate(self, found: Alignment, views: list[View]) -> None:
        """Raise if too few matches agree, or the uncertainty exceeds the configured limits."""
        agreeing, matched = int(found.inliers.sum()), sum(len(view.rows) for view in views)
        enough = (found.inliers >= MIN_MATCHES).sum() >= MIN_VIEWS
        if not enough or agreeing < MIN_AGREEING * matched:
            raise InsufficientEvidence(
                f"only {agreeing} of {matched} matches in {len(views)} frames fit one motion; check calibration, "
                "IMU axes and units, imu.gyro_bias_sigma, backend.sigma_px and, for a rolling shutter, rig.readout_s"
            )
        span_s = sum(view.motion.dt_s for view in views)
        turn = float(np.linalg.norm(found.gyro_bias)) * span_s
        if turn > MAX_BIAS_TURN_RAD:
            raise InsufficientEvidence(
                f"the gyro's bias alone rotates by {turn:.2f} rad within {span_s:.1f} s, more than "
                f"{MAX_BIAS_TURN_RAD:g}: frames are too far apart, or the gyro needs calibration"
            )
        start, tilt_deg = self._config.start, float(np.rad2deg(self._sigma_tilt_rad(found)))
        velocity = _largest_sigma(found, VELOCITY)
        if velocity > start.velocity_sigma or tilt_deg > MAX_TILT_SIGMA_DEG:
            bias_deg = np.rad2deg(self._config.imu.accel_bias_sigma / self._config.imu.gravity)
            raise InsufficientEvidence(
                f"velocity is known to {velocity:.2f} m/s and tilt to {tilt_deg:.2f} deg only, not to "
                f"{start.velocity_sigma:g} m/s and {MAX_TILT_SIGMA_DEG:g} deg; start.velocity_sigma sets the "
                f"former, imu.accel_bias_sigma leaves {bias_deg:.2f} deg of the latter, and more points that stay in "
                "view longer improve both"
            )


def _largest_sigma(found: Alignment, part: slice) -> float:
    """Return the largest standard deviation of a part of the motion."""
    return float(np.sqrt(np.linalg.eigvalsh(found.covariance[part, part])[-1]))
