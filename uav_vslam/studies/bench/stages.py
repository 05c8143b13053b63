# SPDX-License-Identifier: Apache-2.0
"""Processor time of each stage, beside a reference measured alternately in the same run.

Machines differ and are noisy, so a time alone says little: work and reference alternate, and the result is the median
of the ratios of consecutive pairs. Times are processor times, so other load does not count. The back end's
reference is in `back_end`; most others are numpy's Cholesky factor of a matrix as large as the stage's own state.
"""

import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from uav_vslam.config import FrontendConfig, FusionConfig, ImuConfig
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.estimation.covariance_intersection import WEIGHT_BOUNDS, WEIGHTS, EstimatePair, Split
from uav_vslam.evaluation.study import Row
from uav_vslam.geometry.pose import POSE_DIM, Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.preintegration import preintegrate
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.slam.packet import PacketPolicy, make_packet, payload_bytes, validate
from uav_vslam.types import (
    NS_PER_S,
    ImuIncrement,
    ImuSample,
    JointInformation,
    LandmarkPacket,
    StereoFeatures,
    StereoFrame,
)
from uav_vslam.vision.stereo_points import StereoFrontend
from uav_vslam.vision.tracking.flow import FlowImage
from uav_vslam.vision.tracking.frontend import TrackingFrontend

Array = NDArray[np.float64]
Work = Callable[[], object]

OWN_LANDMARKS = 100


def take_turns(works: Iterable[Work], reference: Work) -> tuple[float, float]:
    """Run each work and, right after it, the reference.

    Returns:
        Median time of the works [ms], and median ratio of a work's time to its reference's.
    """
    reference()  # once for caches and lazy imports
    ms, _, ratio = medians((work, reference) for work in works)
    return ms, ratio


def medians(pairs: Iterable[tuple[Work, Work]]) -> tuple[float, float, float]:
    """Run pairs of works.

    Returns:
        Median times of the first ones and of the second ones [ms], and median ratio of the two times of a pair.
    """
    times = np.array([(_ms(first), _ms(second)) for first, second in pairs])
    first, second = np.median(times, axis=0)
    return float(first), float(second), float(np.median(times[:, 0] / times[:, 1]))


def rendered_frames(count: int) -> tuple[SimulatedVehicle, list[StereoFrame]]:
    """Return a flight at 1280 x 960 and its first image pairs."""
    vehicle = simulate_vehicle(Scenario(frames=max(count, 2)), 0)
    images = RenderedFlight(vehicle)
    return vehicle, [images.frame(k) for k in range(count)]


def stereo_front_end(
    vehicle: SimulatedVehicle, frames: Sequence[StereoFrame], sift: Callable[[NDArray[Any]], object]
) -> Row:
    """Time the front end at its default half resolution; `sift` is plain SIFT on a whole image."""
    config = FrontendConfig(method="sift")
    frontend = StereoFrontend(vehicle.rig, config)
    frontend.process(frames[0])
    ms, ratio = take_turns(
        [lambda frame=frame: frontend.process(frame) for frame in frames],  # type: ignore[misc]
        lambda: (sift(frames[0].left), sift(frames[0].right)),
    )
    size = f"{vehicle.rig.left.width}x{vehicle.rig.left.height}"
    condition = f"{size}, scale {config.scale:g}"
    return row("stereo front end", condition, "OpenCV SIFT, scale 1", ratio, ms_per_frame=ms)


def live_front_end(
    vehicle: SimulatedVehicle, frames: Sequence[StereoFrame], sift: Callable[[NDArray[Any]], object]
) -> Row:
    """Time the tracking front end over consecutive pairs, the mean of all and of each of its parts.

    The reference is plain SIFT on both whole images.
    """
    frontend = TimedFrontend(vehicle.rig, FrontendConfig(method="klt"))
    frontend.process(frames[0])
    frontend.spent_ms = dict.fromkeys(frontend.spent_ms, 0.0)
    ms = _ms(lambda: [frontend.process(frame) for frame in frames[1:]])
    reference_ms = float(np.median([_ms(lambda: (sift(frames[0].left), sift(frames[0].right))) for _ in range(2)]))
    parts = frontend.spent_ms | {"search": ms - sum(frontend.spent_ms.values())}
    count = len(frames) - 1
    parts_ms = ", ".join(f"{name} {part / count:.1f}" for name, part in parts.items())
    size = f"{vehicle.rig.left.width}x{vehicle.rig.left.height}"
    condition = f"{size}, {count} frames; ms: {parts_ms}"
    return row("live front end", condition, "OpenCV SIFT, scale 1", ms / count / reference_ms, ms_per_frame=ms / count)


class TimedFrontend(TrackingFrontend):
    """Measures its own thread; the rest of the processor time, the other thread's, is feature detection.

    Attributes:
        spent_ms: "images" are local means and the cameras' health, "in time" and "across" the two trackings.
    """

    def __init__(self, rig: StereoRig, config: FrontendConfig) -> None:
        super().__init__(rig, config)
        self.spent_ms = dict.fromkeys(("images", "in time", "across"), 0.0)

    def process(self, frame: StereoFrame) -> StereoFeatures:
        begin, before = time.thread_time(), dict(self.spent_ms)
        features = super().process(frame)
        others = sum(self.spent_ms[name] - before[name] for name in ("in time", "across"))
        self.spent_ms["images"] += (time.thread_time() - begin) * 1e3 - others
        return features

    def _track(self, stamp_ns: int, left: FlowImage) -> None:
        begin = time.thread_time()
        super()._track(stamp_ns, left)
        self.spent_ms["in time"] += (time.thread_time() - begin) * 1e3

    def _features(self, stamp_ns: int, left: FlowImage, right: FlowImage) -> StereoFeatures:
        begin = time.thread_time()
        features = super()._features(stamp_ns, left, right)
        self.spent_ms["across"] += (time.thread_time() - begin) * 1e3
        return features


def preintegration(repeats: int) -> Row:
    """Time one increment between images at 7.14 Hz from readings at 200 Hz."""
    rng, imu = np.random.default_rng(1), ImuConfig()
    samples = [ImuSample(5_000_000 * k, rng.normal(0, 0.1, 3), rng.normal(0, 1.0, 3)) for k in range(29)]
    bias = np.zeros(3)
    F, Q = np.eye(9) + 1e-3 * rng.normal(size=(9, 9)), 1e-6 * np.eye(9)

    def recursion() -> Array:
        P = np.zeros((9, 9))
        for _ in samples:
            P = F @ P @ F.T + Q
        return P

    def increment() -> ImuIncrement:
        return preintegrate(samples, 0, samples[-1].stamp_ns, gyro_bias=bias, accel_bias=bias, imu=imu)

    ms, ratio = take_turns([increment] * repeats, recursion)
    condition = f"{len(samples)} readings"
    return row("preintegration", condition, f"{len(samples)} covariance steps 9x9", ratio, ms_per_frame=ms)


def fusion(shared: int, repeats: int) -> Row:
    """Time the fusion of one packet, all of whose landmarks are shared."""
    count = max(OWN_LANDMARKS, shared)
    own = _belief("uav1", count, stamp_s=11.0)
    peer = _belief("uav2", shared, stamp_s=10.0)
    core = Fusion("uav1", FusionConfig())
    core.inbox.add(make_packet(peer, sequence=1, policy=PacketPolicy(max_landmarks=shared)))
    size = POSE_DIM + 3 * count
    # A new belief each time, because it caches its inverse.
    ms, ratio = take_turns([lambda: core.fuse(dataclasses.replace(own))] * repeats, _cholesky(size))
    found = core.epoch.common["uav2"] if core.epoch else 0
    condition = f"{count} own landmarks, {shared} shared"
    return row("fusion", condition, _cholesky_name(size), ratio, ms_per_packet=ms, landmarks=found)


def weight_search(shared: int, repeats: int) -> Row:
    """Time finding the weight of an intersection, beside scipy's search over the whole fused covariance."""
    count = max(OWN_LANDMARKS, shared)
    own_belief = _belief("uav1", count, stamp_s=1.0, sigma_m=(0.3, 0.15, 0.3))
    peer_belief = _belief("uav2", shared, stamp_s=1.0, sigma_m=(0.15, 0.3, 0.3))  # along other axes
    P = own_belief.covariance
    R = peer_belief.covariance[POSE_DIM:, POSE_DIM:]
    own, peer = Split(np.zeros_like(P), P), Split(0.09 * np.eye(len(R)), R)
    E = np.eye(len(R), len(P), POSE_DIM)

    def whole(weight: float) -> float:
        P1, P2 = own.inflated(weight), peer.inflated(1.0 - weight)
        K = P1 @ E.T @ np.linalg.inv(E @ P1 @ E.T + P2)
        return float(np.trace((P1 - K @ E @ P1)[:3, :3]))

    def theirs() -> float:
        bounds = (WEIGHT_BOUNDS[0], WEIGHT_BOUNDS[1] - 1e-6)
        return float(minimize_scalar(whole, bounds=bounds, method="bounded", options={"xatol": 1e-3}).x)

    def ours() -> float:
        return WEIGHTS["position_trace"](EstimatePair(own, E, peer))

    ms, ratio = take_turns([ours] * repeats, theirs)
    condition = f"{shared} shared, weight {ours():.3f}, reference's {theirs():.3f}"
    return row("weight search", condition, "scipy over the whole", ratio, ms_per_packet=ms)


def packets(landmarks: int, policy: PacketPolicy, repeats: int) -> list[Row]:
    """Time making a packet and reading it: checks and decoding."""
    joint = _belief("uav1", OWN_LANDMARKS, stamp_s=10.0)
    policy = dataclasses.replace(policy, max_landmarks=landmarks)
    packet = make_packet(joint, sequence=1, policy=policy)

    def encode() -> LandmarkPacket:
        return make_packet(dataclasses.replace(joint), sequence=1, policy=policy)

    def decode() -> tuple[Array, Array]:
        validate(packet)
        return packet.positions, packet.covariance

    rows, condition = [], f"{policy.form}, {landmarks} landmarks, {payload_bytes(packet)} B"
    for method, work in (("make packet", encode), ("read packet", decode)):
        ms, ratio = take_turns([work] * repeats, _cholesky(3 * landmarks))
        times = {"ms_per_packet": ms, "us_per_landmark": 1e3 * ms / landmarks}
        rows.append(row(method, condition, _cholesky_name(3 * landmarks), ratio, **times))
    return rows


def row(method: str, condition: str, reference: str, ratio: float, **figures: float) -> Row:
    """Return the row of one measurement."""
    return {"method": method, "condition": condition, **figures, "ratio_to_reference": ratio, "reference": reference}


def _ms(work: Work) -> float:
    begin = time.process_time_ns()
    work()
    return (time.process_time_ns() - begin) * 1e-6


def _cholesky(size: int) -> Work:
    A = np.random.default_rng(0).normal(size=(size, size))
    P = A @ A.T + size * np.eye(size)
    return lambda: np.linalg.cholesky(P)


def _cholesky_name(size: int) -> str:
    return f"Cholesky {size}x{size}"


def _belief(
    vehicle: str, count: int, *, stamp_s: float, sigma_m: tuple[float, float, float] = (0.3, 0.3, 0.3)
) -> JointInformation:
    """Return a belief with a common error of pose and landmarks; the first ones are the same for all vehicles."""
    generators = [np.random.default_rng([7, identity]) for identity in range(count)]
    positions = np.array([rng.uniform([-60, -60, -2], [60, 60, 2]) for rng in generators])
    descriptors = np.array([rng.integers(0, 256, 128, np.uint8) for rng in generators])
    n = POSE_DIM + 3 * count
    common = np.zeros((n, 3))
    common[:3] = np.diag(sigma_m)
    common[POSE_DIM:] = np.tile(np.diag(sigma_m), (count, 1))
    own = np.full(n, 0.1**2)
    own[3:POSE_DIM] = 1e-3**2
    information = np.linalg.inv(common @ common.T + np.diag(own))
    return JointInformation(
        stamp_ns=round(stamp_s * NS_PER_S),
        vehicle=vehicle,
        session=1,
        T_map_body=Pose(np.eye(3), np.array([0.0, 0.0, 70.0])),
        ids=np.arange(1, count + 1, dtype=np.uint32),
        positions=positions,
        information=0.5 * (information + information.T),
        descriptors=descriptors,
    )
