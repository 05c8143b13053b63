# SPDX-License-Identifier: Apache-2.0
"""A simulated flight of a fleet, fully described by one record; equal records give equal bytes."""

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import IMU_GRADES, ImuConfig
from uav_vslam.errors import ConfigError
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.flight_path import MIRRORED, PATTERNS, fly, mirrored
from uav_vslam.simulation.imu import ImuReadings, simulate_imu
from uav_vslam.simulation.rig import kagaru_rig, rotated_right
from uav_vslam.simulation.trajectory import Trajectory
from uav_vslam.types import NS_PER_S, NavEstimate, NavState

START_NS = 1_283_212_800 * NS_PER_S  # 2010-08-31, the day of the Kagaru flights
IMU_PERIOD_NS = 5_000_000  # 200 Hz
IMU_MARGIN_NS = 100_000_000  # readings begin this long before the first and end after the last frame


class Purpose(enum.IntEnum):
    """What a random stream is for: each vehicle has one stream per purpose, so they are independent."""

    MOTION = 0
    IMU = 1
    INITIAL = 2
    EXTRINSIC = 3
    PIXELS = 4
    LEFT_IMAGE = 5
    RIGHT_IMAGE = 6
    LANDMARKS = 7
    RELIEF = 8
    TEXTURE = 9
    OBJECTS = 10


FLEET = 1000  # vehicle number of the streams that all vehicles share
MOST_FRAMES = 1_000_000  # 39 hours, whose truth fits in memory
# Beyond, images show nothing, take minutes each, or the right camera sees the horizon.
MOST = {"contrast": 10.0, "blur_px": 200.0, "noise_sigma": 255.0, "vibration_deg": 5.0}


@dataclass(frozen=True, slots=True)
class Scenario:
    """Everything that a simulated flight depends on."""

    name: str = "kagaru"
    seed: int = 1
    vehicles: int = 2
    frames: int = 160
    frame_rate_hz: float = 7.14
    frame_offset_s: float = 0.03  # each vehicle's cameras trigger this much later than the previous vehicle's [s]
    pattern: str = "leg"  # name in flight_path.PATTERNS
    speed: float = 20.0  # [m/s]
    altitude: float = 70.0  # over the mean ground [m]
    spacing_m: float = 17.0  # between neighbours, across the first leg's direction
    relief_m: float = 2.0  # root mean square height of the ground
    imu: str = "adis16480"  # name in config.IMU_GRADES
    scale: float = 1.0  # image size as a multiple of 1280 x 960
    objects: bool = False  # barns, hedges, trees and posts stand on the ground and cast shadows
    colour: bool = False  # images are BGR instead of grey
    texture: str = "grass"  # "grass" (procedural), or the path of an image or a folder of images
    texture_m_per_px: float = 0.05  # size of a texture image's pixel on the ground [m]
    contrast: float = 1.0  # of the ground in the images, before their noise
    blur_px: float = 1.0  # motion blur along the image motion, at full resolution [px]
    noise_sigma: float = 2.0  # of the image noise [grey levels]
    right_gain: float = 1.0  # brightness of the right camera relative to the left one
    right_vignette: float = 0.0  # share of its brightness that the right camera loses in the corners
    vibration_deg: float = 0.0  # rms of each axis of the right camera's attitude, independent per frame
    extrinsic_bias_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # constant error of the right camera's attitude
    disparity_bias_px: float = 0.0  # constant error of the disparity: the right principal point is off along it
    focal_ratio_bias: float = 0.0  # share by which the right camera's focal length is longer than calibrated
    sigma_position_m: float = 0.05  # of the initial state, per axis
    sigma_velocity: float = 0.1  # of the initial state, per axis [m/s]
    sigma_tilt_deg: float = 0.2  # of the initial state, about east and north
    sigma_yaw_deg: float = 0.5  # of the initial state, about the vertical
    sigma_map_m: float = 0.0  # of the map that all start states were measured in: an error they share, per axis

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise ConfigError(f"scenario pattern {self.pattern!r} is not known; use one of {', '.join(PATTERNS)}")
        if self.imu not in IMU_GRADES:
            raise ConfigError(f"imu grade {self.imu!r} is not known; use one of {', '.join(IMU_GRADES)}")
        fastest_hz = NS_PER_S / IMU_PERIOD_NS
        if not (
            2 <= self.frames <= MOST_FRAMES and 1 <= self.vehicles < FLEET and 0 < self.frame_rate_hz <= fastest_hz
        ):
            raise ConfigError(
                f"scenario has {self.frames} frames at {self.frame_rate_hz} Hz and {self.vehicles} vehicles; use 2 to "
                f"{MOST_FRAMES} frames, a rate above 0 and up to {fastest_hz:g} Hz, the IMU's, and 1 to {FLEET - 1} "
                "vehicles"
            )
        if not 0.05 <= self.scale <= 1.0:
            raise ConfigError(f"scenario scale {self.scale} is not allowed; use 0.05 to 1")
        for name, most in MOST.items():
            if not 0.0 <= getattr(self, name) <= most:
                raise ConfigError(
                    f"scenario {name} {getattr(self, name)} is not allowed; use a number from 0 to {most:g}"
                )

    @property
    def imu_config(self) -> ImuConfig:
        """Noise of the IMU."""
        return IMU_GRADES[self.imu]

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame [s]."""
        return (self.frames - 1) / self.frame_rate_hz

    def vehicle_name(self, index: int) -> str:
        """Return the ROS namespace of vehicle 0, 1, ...: uav1, uav2, ..."""
        return f"uav{index + 1}"

    def rng(self, vehicle: int, purpose: Purpose) -> np.random.Generator:
        """Return the random stream of one vehicle for one purpose, from its start."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, vehicle, int(purpose)]))


SCENARIOS = {
    "kagaru": Scenario(),
    "sample": Scenario(name="sample", frames=64, scale=0.375, noise_sigma=1.0, imu="consumer"),
    "long": Scenario(name="long", frames=1000, pattern="lawnmower"),
    "revisit": Scenario(name="revisit", vehicles=1, frames=780, pattern="circuit"),
    "parting": Scenario(name="parting", frames=1000, pattern="parting"),
}


@dataclass(frozen=True, slots=True)
class SimulatedVehicle:
    """One vehicle's flight: ground truth, IMU readings, frame stamps and initial estimate.

    Attributes:
        name: ROS namespace.
        index: number in the fleet, from 0.
        scenario: what was simulated.
        truth: the motion; its t = 0 is the first frame.
        imu: readings from just before the first to just after the last frame.
        frame_stamps_ns: (F,) int64 exposure times [ns].
        initial: estimated state at the first frame; true biases are in `imu`.
        rig: the calibration that the vehicle uses.
        right_rotations: (F, 3) true rotation of the right camera away from `rig`, in its own frame [rad].
    """

    name: str
    index: int
    scenario: Scenario
    truth: Trajectory
    imu: ImuReadings
    frame_stamps_ns: NDArray[np.int64]
    initial: NavEstimate
    rig: StereoRig
    right_rotations: NDArray[np.float64]

    @property
    def frame_times_s(self) -> NDArray[np.float64]:
        """(F,) times of the frames since the first one [s]."""
        return self.truth.time_s(self.frame_stamps_ns)

    def true_rig(self, frame: int) -> StereoRig:
        """Return the true rig at frame `frame`."""
        turned = rotated_right(self.rig, self.right_rotations[frame])
        return turned.disparity_shifted(self.scenario.disparity_bias_px).right_magnified(self.scenario.focal_ratio_bias)

    def true_state(self, stamp_ns: int) -> NavState:
        """Return the true state, with the biases of the nearest reading."""
        t = float(self.truth.time_s(stamp_ns))
        k = int(np.argmin(np.abs(self.imu.stamps_ns - stamp_ns)))
        return NavState(
            stamp_ns, self.truth.pose(t), self.truth.velocity(t), self.imu.gyro_bias[k], self.imu.accel_bias[k]
        )


def simulate_vehicle(scenario: Scenario, index: int) -> SimulatedVehicle:
    """Fly vehicle `index` (0, 1, ...) of a scenario."""
    offset_ns = round(index * scenario.frame_offset_s * NS_PER_S)
    frame_ns = np.round(np.arange(scenario.frames) * (NS_PER_S / scenario.frame_rate_hz)).astype(np.int64)
    frame_stamps = START_NS + offset_ns + frame_ns
    truth = _motion(scenario, index, int(frame_stamps[0]))
    imu = simulate_imu(truth, _imu_stamps(frame_stamps), scenario.imu_config, rng=scenario.rng(index, Purpose.IMU))
    return SimulatedVehicle(
        name=scenario.vehicle_name(index),
        index=index,
        scenario=scenario,
        truth=truth,
        imu=imu,
        frame_stamps_ns=frame_stamps,
        initial=initial_estimate(scenario, truth, rng=scenario.rng(index, Purpose.INITIAL)),
        rig=kagaru_rig(scenario.scale),
        right_rotations=_right_rotations(scenario, scenario.rng(index, Purpose.EXTRINSIC)),
    )


def simulate_fleet(scenario: Scenario) -> list[SimulatedVehicle]:
    """Fly all vehicles of a scenario."""
    return [simulate_vehicle(scenario, index) for index in range(scenario.vehicles)]


def initial_estimate(scenario: Scenario, truth: Trajectory, *, rng: np.random.Generator) -> NavEstimate:
    """Return the first frame's state with errors drawn from the scenario's sigmas; biases are estimated as zero.

    Errors follow `NavEstimate`: R_true = Exp(xi) R, differences of position and velocity in the map frame, which
    coincides with the world frame.
    """
    tilt, yaw = np.deg2rad([scenario.sigma_tilt_deg, scenario.sigma_yaw_deg])
    imu = scenario.imu_config
    sigma = np.repeat(
        [scenario.sigma_position_m, scenario.sigma_velocity, 0.0, imu.gyro_bias_sigma, imu.accel_bias_sigma], 3
    )
    sigma[6:9] = tilt, tilt, yaw
    error = rng.normal(0.0, 1.0, 9) * sigma[:9]
    error[:3] += scenario.rng(FLEET, Purpose.INITIAL).normal(0.0, 1.0, 3) * scenario.sigma_map_m
    sigma[:3] = np.hypot(sigma[:3], scenario.sigma_map_m)
    true_pose = truth.pose(0.0)
    pose = Pose(so3_exp(-error[6:9]) @ true_pose.R, true_pose.t - error[:3])
    state = NavState(truth.start_ns, pose, truth.velocity(0.0) - error[3:6], np.zeros(3), np.zeros(3))
    return NavEstimate(state, np.diag(sigma**2))


def _motion(scenario: Scenario, index: int, start_ns: int) -> Trajectory:
    segments = PATTERNS[scenario.pattern](scenario.duration_s, scenario.speed)
    return fly(
        mirrored(segments) if index % 2 and scenario.pattern in MIRRORED else segments,
        start_ns=start_ns,
        duration_s=scenario.duration_s,
        speed=scenario.speed,
        altitude=scenario.altitude,
        offset_world=(0.0, -index * scenario.spacing_m),
        rng=scenario.rng(index, Purpose.MOTION),
    )


def _imu_stamps(frame_stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.arange(
        frame_stamps_ns[0] - IMU_MARGIN_NS, frame_stamps_ns[-1] + IMU_MARGIN_NS + 1, IMU_PERIOD_NS, dtype=np.int64
    )


def _right_rotations(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    vibration = rng.normal(0.0, np.deg2rad(scenario.vibration_deg), (scenario.frames, 3))
    return np.asarray(np.deg2rad(scenario.extrinsic_bias_deg) + vibration)
