# SPDX-License-Identifier: Apache-2.0
"""Records that stages exchange, mostly as messages of the same content, from `uav_vslam_msgs` or a standard package.

Frames: `map` is the vehicle's local ENU frame (z up, gravity along -z), shared by a fleet that starts from a common
origin; `body` is FLU, the vehicle's base frame, to which IMU readings are moved. Stamps are nanoseconds since
the epoch of the recording. Records are immutable.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.coded_points import CodedPoints
from uav_vslam.geometry.pose import Pose

Array = NDArray[np.float64]

NS_PER_S = 1_000_000_000
POSE_ROWS = np.array([0, 1, 2, 6, 7, 8])  # position and rotation in the covariance of a `NavEstimate`


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One IMU reading, in the body frame.

    Attributes:
        stamp_ns: time of the reading [ns].
        gyro: (3,) angular rate [rad/s].
        accel: (3,) specific force [m/s^2]; +9.81 along z at rest and level.
        measured: (3,) the same where the IMU is, without the noise of moving it to the body's origin; None if that is
            its place.
    """

    stamp_ns: int
    gyro: Array
    accel: Array
    measured: Array | None = None

    @property
    def accel_at_imu(self) -> Array:
        """(3,) specific force where the IMU is, in the body's axes [m/s^2]."""
        return self.accel if self.measured is None else self.measured

    @property
    def is_finite(self) -> bool:
        """Return whether it holds neither NaN nor infinity."""
        return all(map(math.isfinite, (*self.gyro.tolist(), *self.accel.tolist())))


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """A synchronised image pair.

    Attributes:
        stamp_ns: exposure time [ns].
        left, right: (H, W) grey or (H, W, 3) BGR images, uint8 or uint16.
    """

    stamp_ns: int
    left: NDArray[np.generic]
    right: NDArray[np.generic]


@dataclass(frozen=True, slots=True)
class StereoFeatures:
    """Matched points of one stereo pair.

    Attributes:
        stamp_ns: stamp of the pair [ns].
        pixels: (N, 4) float32 undistorted u_left, v_left, u_right, v_right [px].
        descriptors: (N, D) uint8 descriptors of the left points.
        tracks: (N,) uint32 feature track id, the same over all pairs that show the point and unique within a flight;
            0 for an untracked point, the default.
    """

    stamp_ns: int
    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    tracks: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))

    def __post_init__(self) -> None:
        if len(self.tracks) == 0:
            object.__setattr__(self, "tracks", np.zeros(len(self.pixels), np.uint32))

    @staticmethod
    def empty(stamp_ns: int) -> "StereoFeatures":
        """Return a frame without points."""
        return StereoFeatures(stamp_ns, np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8))

    @property
    def without_descriptors(self) -> "StereoFeatures":
        """The points and their tracks alone."""
        return StereoFeatures(self.stamp_ns, self.pixels, self.descriptors[:, :0].copy(), self.tracks)

    def chosen(self, rows: NDArray[np.intp]) -> "StereoFeatures":
        """Return the points in `rows`."""
        return StereoFeatures(self.stamp_ns, self.pixels[rows], self.descriptors[rows], self.tracks[rows])

    def __len__(self) -> int:
        return len(self.pixels)


@dataclass(frozen=True, slots=True)
class ImuIncrement:
    """Preintegrated motion between two image stamps, linearised at a stated bias (Forster et al. 2017).

    Attributes:
        start_ns, stamp_ns: ends of the interval [ns].
        samples: number of IMU readings inside; 0 over more than an IMU period means that the motion was not measured.
        delta_R: (3, 3) R_start_end.
        delta_v: (3,) change of velocity without gravity, in the start body frame [m/s].
        delta_p: (3,) displacement without gravity and initial velocity, in the start body frame [m].
        rate_start, rate_end: (3,) angular rates at the ends, bias included, by straight lines through the gyroscope's
            nearest readings, body frame [rad/s].
        rate_slope_start, rate_slope_end: (3,) slopes of these lines [rad/s^2].
        gyro_bias, accel_bias: (3,) linearisation point [rad/s], [m/s^2].
        bias_jacobian: (9, 6) d(rotation, velocity, position)/d(gyro bias, accel bias); the rotation is perturbed
            on the right.
        covariance: (9, 9) of (rotation, velocity, position), from the white noise of the readings.
        gyro_noise, accel_noise: its densities [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    """

    start_ns: int
    stamp_ns: int
    samples: int
    delta_R: Array
    delta_v: Array
    delta_p: Array
    rate_start: Array
    rate_end: Array
    rate_slope_start: Array
    rate_slope_end: Array
    gyro_bias: Array
    accel_bias: Array
    bias_jacobian: Array
    covariance: Array
    gyro_noise: float
    accel_noise: float

    @property
    def dt_s(self) -> float:
        """Length of the interval [s]."""
        return (self.stamp_ns - self.start_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class NavState:
    """Mean of the navigation state at one stamp.

    Attributes:
        stamp_ns: time [ns].
        T_map_body: pose.
        v_map: (3,) velocity [m/s].
        gyro_bias, accel_bias: (3,) [rad/s], [m/s^2].
    """

    stamp_ns: int
    T_map_body: Pose
    v_map: Array
    gyro_bias: Array
    accel_bias: Array


@dataclass(frozen=True, slots=True)
class NavEstimate:
    """A navigation state with its uncertainty.

    Attributes:
        state: the mean.
        covariance: (15, 15), order position, velocity, rotation (map-frame rotation vector xi, R_true = Exp(xi) R),
            gyro bias, accel bias. Position and velocity errors are plain differences in the map frame.
    """

    state: NavState
    covariance: Array

    @property
    def pose(self) -> "PoseEstimate":
        """The pose part."""
        return PoseEstimate(self.state.stamp_ns, self.state.T_map_body, self.covariance[POSE_ROWS[:, None], POSE_ROWS])


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """A pose with its uncertainty, as odometry publishes it.

    Attributes:
        stamp_ns: time [ns].
        T_map_body: pose.
        covariance: (6, 6), order position, rotation (map-frame rotation vector).
    """

    stamp_ns: int
    T_map_body: Pose
    covariance: Array


@dataclass(frozen=True, slots=True)
class Twist:
    """Motion of the body, in the body frame.

    Attributes:
        linear: (3,) velocity [m/s].
        angular: (3,) rate [rad/s].
        covariance: (6, 6), order linear, angular.
    """

    linear: Array
    angular: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class FrameQuality:
    """How the back end fared in one frame, judged without ground truth.

    Attributes:
        stamp_ns: of the frame [ns].
        features: stereo points offered.
        tracked: those whose track was in the frame before.
        associated: points that corrected the state: landmarks, and up to 50 tracks.
        downweighted: landmarks that fitted badly.
        landmarks: in the state afterwards.
        coasted: the state was propagated by the IMU alone.
        relocalised: gating failed and the whole map was searched.
        restarted: the filter was re-initialised.
        closures: associated landmarks that had not been seen for long.
        nis: normalised innovation squared of the update, 0 without one.
        dof: its degrees of freedom, 0 without an update.
        gate_probability: of the gate that let the observations in.
        events: problems reported at this frame.
        time_offset_s, time_offset_sigma_s: exposure minus stamp by the IMU's clock, as estimated; sigma 0 if it is not.
        disparity_error_px, disparity_error_sigma_px: of the calibration, as estimated; sigma 0 if it is not.
    """

    stamp_ns: int
    features: int
    tracked: int
    associated: int
    downweighted: int
    landmarks: int
    coasted: bool
    relocalised: bool
    restarted: bool
    closures: int
    nis: float
    dof: int
    gate_probability: float
    events: tuple[str, ...] = ()
    time_offset_s: float = 0.0
    time_offset_sigma_s: float = 0.0
    disparity_error_px: float = 0.0
    disparity_error_sigma_px: float = 0.0


@dataclass(frozen=True, slots=True)
class LinkEpoch:
    """The traffic of one vehicle up to a fusion epoch, counted from its start.

    Attributes:
        stamp_ns: of the epoch [ns].
        packets_sent, bytes_sent: accepted by the budget, and their payload [byte].
        packets_received, bytes_received: from all peers, dropped ones included.
        packets_used: fused.
    """

    stamp_ns: int
    packets_sent: int
    bytes_sent: int
    packets_received: int
    bytes_received: int
    packets_used: int


def source_of(vehicle: str, session: int) -> str:
    """Return the provenance key of the measurements of one session (start) of a vehicle."""
    return f"{vehicle}/{session}"


@dataclass(frozen=True)  # no slots: the covariance is cached
class JointInformation:
    """Joint belief over the pose and all landmarks from own sensors alone, for the vehicle's own fusion node.

    Attributes:
        stamp_ns: time of the pose [ns].
        vehicle, session: name, and number of its start.
        T_map_body: pose.
        ids: (N,) landmark ids, unique within the session.
        positions: (N, 3) landmarks in the map frame [m].
        information: (6+3N, 6+3N) information matrix, order position, rotation (map frame), landmarks.
        descriptors: (N, D) uint8.
        prior_id: hash of the map that the start depends on; "" for none.
        other_sources: "vehicle/session" of that map's measurements.
    """

    stamp_ns: int
    vehicle: str
    session: int
    T_map_body: Pose
    ids: NDArray[np.uint32]
    positions: Array
    information: Array
    descriptors: NDArray[np.uint8]
    prior_id: str = ""
    other_sources: tuple[str, ...] = ()

    @property
    def source(self) -> str:
        """Provenance key of these measurements: "vehicle/session"."""
        return source_of(self.vehicle, self.session)

    @property
    def sources(self) -> tuple[str, ...]:
        """All provenance keys, the own first."""
        return (self.source, *(source for source in self.other_sources if source != self.source))

    @cached_property
    def covariance(self) -> Array:
        """(6+3N, 6+3N) inverse of the information; cached, as an epoch needs it several times.

        Raises:
            FilterDivergence: the information is not positive definite.
        """
        from uav_vslam.numerics import inverse_spd  # brings scipy, a third of the start of a node that needs none

        P = inverse_spd(self.information, "joint information")
        P.flags.writeable = False
        return P


@dataclass(frozen=True, slots=True)
class MappedLandmarks:
    """Landmarks in the map frame, each with its own covariance.

    Attributes:
        ids: (N,) unique identifiers.
        positions: (N, 3) [m].
        covariances: (N, 3, 3) [m^2].
    """

    ids: NDArray[np.uint32]
    positions: Array
    covariances: Array

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, slots=True)
class LandmarkPacket:
    """Self-contained marginal over some landmarks of one vehicle, as sent over the radio.

    Attributes:
        stamp_ns: time of the estimate [ns].
        vehicle, session, sequence: sender, number of its start, and packet count since its fusion node started.
        sources: provenance: "vehicle/session" of all measurements inside, the sender's own included.
        prior_id: hash of a prior map or shared survey; "" for none.
        ids: (N,) landmark ids of the sender.
        origin: (3,) int32 reference point of the offsets, in the sender's map frame [m].
        points: coded landmarks and covariance.
        covariance_scale: factor >= 1; the coded covariance times it is an upper bound of the exact one.
        descriptor_basis: number of the basis in vision.compact_descriptors, 0 for raw descriptors.
        descriptors: (N, D) uint8.
        checksum: CRC-32 over all other fields but the tag, see slam.packet.
        tag: authentication tag, see cooperation.authentication; empty for none.
    """

    stamp_ns: int
    vehicle: str
    session: int
    sequence: int
    sources: tuple[str, ...]
    prior_id: str
    ids: NDArray[np.uint32]
    origin: NDArray[np.int32]
    points: CodedPoints
    covariance_scale: float
    descriptor_basis: int
    descriptors: NDArray[np.uint8]
    checksum: int
    tag: bytes = b""

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def order(self) -> tuple[int, int]:
        """Stamp and sequence: of one session's packets the largest is the newest, and replaces all others.

        The stamp comes first because a restarted fusion node counts from zero.
        """
        return self.stamp_ns, self.sequence

    @property
    def source(self) -> str:
        """The sender's own provenance key."""
        return source_of(self.vehicle, self.session)

    @property
    def other_sources(self) -> tuple[str, ...]:
        """The sources without the sender's own, which is implied."""
        return tuple(source for source in self.sources if source != self.source)

    @property
    def positions(self) -> Array:
        """(N, 3) landmarks in the sender's map frame [m]."""
        return np.asarray(self.origin + self.points.offsets_m)

    @property
    def covariance(self) -> Array:
        """(3N, 3N) covariance of the landmarks [m^2], an upper bound of the sender's."""
        return np.asarray(self.covariance_scale * self.points.covariance)
