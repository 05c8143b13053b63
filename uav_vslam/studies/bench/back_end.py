# SPDX-License-Identifier: Apache-2.0
"""The back end beside GTSAM's fixed-lag smoother: the same features and motions, alternating frame by frame.

Every frame shows N landmarks, each for as long as it is in view, and both use them all. Ours keeps a landmark while it
is in view (`retention: none`), GTSAM until it has not been seen for the lag: with a lag of one frame both hold the same
landmarks. The motion between frames is prepared outside of both times. Ours associates the data, GTSAM is given that.
"""

import itertools
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import gtsam
import numpy as np

from uav_vslam.config import BackendConfig, ImuConfig, VehicleConfig
from uav_vslam.evaluation.study import Row
from uav_vslam.geometry.image_grid import spread
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.landmarks import observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.studies.bench.stages import medians
from uav_vslam.studies.engine.factors import Motion
from uav_vslam.studies.engine.frame_chain import Identities
from uav_vslam.studies.engine.own_only import dead_reckon
from uav_vslam.studies.engine.smoothers import FixedLagSmoother, cholesky_motion
from uav_vslam.types import ImuSample, NavState, StereoFeatures

Frame = tuple[StereoFeatures, Identities]

FRAME_LAG_S = 0.2  # the window holds one frame besides the newest: closest to a filter
TRACK_LAG_S = 2.0  # it holds every frame that shows a landmark: the usual way to run a smoother
WARM_UP = 5  # frames until both have all landmarks and marginalise
CHOLESKY, QR = "CHOLESKY", "QR"
ABUNDANCE = 1.5  # landmarks on the ground for each that a frame shows


def back_end(landmarks: int, frames: int, *, lag_s: float = FRAME_LAG_S, factorisation: str = CHOLESKY) -> Row:
    """Time both over a flight; their errors are those of this one flight.

    Args:
        landmarks: in view of each frame.
        frames: to be timed, after the warm-up.
        lag_s: of the smoother [s].
        factorisation: of the smoother. CHOLESKY is many times faster, but can't use the motion with the covariance that
            was measured and that our filter uses; QR can.
    """
    vehicle = simulate_vehicle(Scenario(frames=WARM_UP + frames, seed=1), 0)
    field = scatter_landmarks([vehicle], per_frame=ABUNDANCE * landmarks)
    seen = thin_out(observe(vehicle, field), landmarks, size=vehicle.rig.left.size)
    ours, theirs = _our_back_end(vehicle, seen), _gtsam(vehicle, seen, lag_s, factorisation)
    for k in range(WARM_UP):
        ours(k)
        theirs(k)
    ms, gtsam_ms, ratio = medians((partial(ours, k), partial(theirs, k)) for k in range(WARM_UP, len(seen)))
    return {
        "method": "back end",
        "condition": f"{landmarks} in view, lag {lag_s:g} s",
        "ms_per_frame": ms,
        **ours.figures(vehicle),
        "ratio_to_reference": ratio,
        "reference": f"GTSAM smoother, {factorisation}",
        "gtsam_ms_per_frame": gtsam_ms,
        **{f"gtsam_{key}": value for key, value in theirs.figures(vehicle).items()},
    }


def thin_out(frames: Iterable[Frame], count: int, *, size: tuple[float, float]) -> list[Frame]:
    """Let each frame show at most `count` landmarks: those that the frame before showed, and others spread evenly."""
    chosen: list[Frame] = []
    shown: Identities = np.zeros(0, np.int64)
    for features, identities in frames:
        again = np.isin(identities, shown)
        old, new = np.flatnonzero(again)[:count], np.flatnonzero(~again & (identities >= 0))
        pixels = features.pixels[:, :2]
        rows = np.concatenate([old, new[spread(pixels[new], count - len(old), size=size, taken=pixels[old])]])
        shown = identities[rows]
        chosen.append((StereoFeatures(features.stamp_ns, features.pixels[rows], features.descriptors[rows]), shown))
    return chosen


class _TimedEstimator:
    """Processes frame k and records the pose and the number of landmarks in the state."""

    def __init__(self, step: Callable[[int], tuple[Pose, int]]) -> None:
        self._step = step
        self._done: list[tuple[Pose, int]] = []

    def __call__(self, k: int) -> None:
        self._done.append(self._step(k))

    def figures(self, vehicle: SimulatedVehicle) -> dict[str, Any]:
        """Return the median number of landmarks, and the position errors [m]."""
        errors = np.array([pose.t for pose, _ in self._done]) - vehicle.truth.position(vehicle.frame_times_s)
        distances = np.linalg.norm(errors, axis=1)
        return {
            "landmarks": round(float(np.median([landmarks for _, landmarks in self._done]))),
            "end_rms_m": float(distances[-1]),
            "ate_rms_m": float(np.sqrt(np.mean(distances**2))),
        }


def _our_back_end(vehicle: SimulatedVehicle, seen: list[Frame]) -> _TimedEstimator:
    most = 2 * max(len(features) for features, _ in seen)  # the cap never applies
    settings = BackendConfig(
        retention="none", max_observations=most, max_new_landmarks=most, max_in_view=most, max_landmarks=most
    )
    config = VehicleConfig(imu=vehicle.scenario.imu_config, backend=settings)
    backend = SlamBackend(vehicle.initial, rig=vehicle.rig, config=config, vehicle=vehicle.name)
    increments, _ = dead_reckon(
        vehicle.initial, vehicle.scenario.imu_config, vehicle.imu.samples(), vehicle.frame_stamps_ns.tolist()
    )

    def step(k: int) -> tuple[Pose, int]:
        report = backend.process(seen[k][0], increments[k])
        return report.pose.T_map_body, report.landmarks

    return _TimedEstimator(step)


def _gtsam(vehicle: SimulatedVehicle, seen: list[Frame], lag_s: float, factorisation: str) -> _TimedEstimator:
    smoother = FixedLagSmoother(
        vehicle.initial,
        rig=vehicle.rig,
        sigma_px=BackendConfig().sigma_px,
        lag_s=lag_s,
        factorisation=factorisation,
    )
    motions = _motions(vehicle, cholesky_motion if factorisation == CHOLESKY else Motion)

    def step(k: int) -> tuple[Pose, int]:
        return smoother.process(*seen[k], motions[k]), smoother.landmarks

    return _TimedEstimator(step)


def _motions(
    vehicle: SimulatedVehicle, kind: Callable[[list[ImuSample], ImuConfig, NavState], Motion]
) -> list[gtsam.PreintegratedCombinedMeasurements | None]:
    """Return the motion up to each frame for GTSAM, by its kind of preintegration; None for the first."""
    motion = kind(vehicle.imu.samples(), vehicle.scenario.imu_config, vehicle.initial.state)
    return [None, *(motion.between(*ends) for ends in itertools.pairwise(vehicle.frame_stamps_ns.tolist()))]
