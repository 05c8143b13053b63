# SPDX-License-Identifier: Apache-2.0
"""GTSAM on our measurements: the optimum as a bound on accuracy, and a smoother as a reference for speed.

Both smoothers are given the data association; our filter has to find it.
"""

import dataclasses
from collections.abc import Sequence

import gtsam
from gtsam.symbol_shorthand import B, V, X

from uav_vslam.config import ImuConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.landmarks import LandmarkField, LandmarkNoise, observe
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.studies.engine.factors import CameraPair, Motion, RectifiedPair, to_pose, to_pose_covariance
from uav_vslam.studies.engine.frame_chain import FrameChain, Identities
from uav_vslam.types import NS_PER_S, ImuSample, NavEstimate, NavState, PoseEstimate, StereoFeatures

RELATIVE_ERROR = 1e-9  # of the cost: a smaller decrease in a step ends the optimisation
MAX_STEPS = 50  # six are usual
# What GTSAM's Cholesky factorisation needs, which refuses pivots below 2^-24 of their diagonal: a frame to frame
# motion and biases noisier than the inertial unit's, but still far more exact than the pixels.
CHOLESKY_INTEGRATION_SIGMA = 3e-3  # of the position [m/sqrt(s)]
CHOLESKY_WALK = 10.0  # times the biases' random walk


def gtsam_batch(
    vehicle: SimulatedVehicle, landmarks: LandmarkField, noise: LandmarkNoise, sigma_px: float
) -> Trajectory:
    """Return the optimum over a simulated flight that shows points, see `batch_optimum`."""
    return batch_optimum(
        vehicle.initial,
        list(observe(vehicle, landmarks, noise=noise)),
        vehicle.imu.samples(),
        rig=vehicle.rig,
        imu=vehicle.scenario.imu_config,
        sigma_px=sigma_px,
    )


def batch_optimum(
    start: NavEstimate,
    frames: Sequence[tuple[StereoFeatures, Identities]],
    samples: Sequence[ImuSample],
    *,
    rig: StereoRig,
    imu: ImuConfig,
    sigma_px: float,
) -> Trajectory:
    """Return the most likely poses given all measurements of a flight, each with its marginal covariance.

    Levenberg-Marquardt, initialised by dead reckoning. By QR: position and biases are so much better known from
    frame to frame than in the map that GTSAM's Cholesky refuses some orders of elimination; with landmarks keyed in
    another order, one flight of twenty stopped 5 m short of the optimum.

    Args:
        start: state at the first frame.
        frames: features and true identities, in stamp order.
        samples: readings over the whole flight.
        rig, imu: calibration and noise.
        sigma_px: standard deviation of each stereo pixel coordinate [px].

    Raises:
        UavVslamError: the optimum was not reached.
    """
    graph, values = whole_flight(start, frames, samples, rig=rig, imu=imu, sigma_px=sigma_px)
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(RELATIVE_ERROR)
    params.setMaxIterations(MAX_STEPS)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    optimum = optimizer.optimize()
    if optimizer.iterations() >= MAX_STEPS:
        raise UavVslamError(f"GTSAM did not reach the optimum of {len(frames)} frames within {MAX_STEPS} steps")
    return _poses(graph, optimum, [features.stamp_ns for features, _ in frames])


def whole_flight(
    start: NavEstimate,
    frames: Sequence[tuple[StereoFeatures, Identities]],
    samples: Sequence[ImuSample],
    *,
    rig: StereoRig,
    imu: ImuConfig,
    sigma_px: float,
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return all factors of a flight, and dead reckoning with the landmarks that it triangulates."""
    motion = Motion(samples, imu, start.state)
    chain = FrameChain(start, rig, CameraPair(rig, sigma_px))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    before_ns = None
    for features, identities in frames:
        measured = None if before_ns is None else motion.between(before_ns, features.stamp_ns)
        new_factors, new_values = chain.add(features, identities, measured)
        graph.push_back(new_factors)
        values.insert(new_values)
        before_ns = features.stamp_ns
    return graph, values


class FixedLagSmoother:
    """GTSAM's incremental fixed-lag smoother (iSAM2), frame by frame, as fast as possible from Python.

    Processor time of a frame [ms] at 200 landmarks in view and lags of 0.2 s and 2 s, over 60 frames of one flight.
    With the same lag all end within 4 mm of each other:

        | factorisation | motion                       | factors of a view | 0.2 s | 2 s |
        |---------------|------------------------------|-------------------|-------|-----|
        | Cholesky      | as exact as measured         |                   |    fails    |
        | QR            | as exact as measured         | two projections   |   222 | 406 |
        | QR            | as exact as measured         | one stereo        |   200 | 303 |
        | QR            | less exact (cholesky_motion) | one stereo        |   185 | 321 |
        | Cholesky      | less exact (cholesky_motion) | two projections   |    23 |  42 |
        | Cholesky      | less exact (cholesky_motion) | one stereo        |    19 |  33 |

    The last is the default; QR allows exactly the noise of our filter. All else is GTSAM's default, but that every
    frame checks what to relinearise: every tenth frame was not faster, and ended 8 cm farther off at the short lag.
    Relinearisation thresholds from 0.01 to 2, wildfire thresholds from 0 to 0.1, partial checks and no cache of linear
    factors gave nothing above timing noise: variables in a marginal factor are never relinearised, and each
    marginalisation re-eliminates most of the rest. Each frame is one update and back-substitutes the newest state only.
    """

    def __init__(
        self, start: NavEstimate, *, rig: StereoRig, sigma_px: float, lag_s: float, factorisation: str = "CHOLESKY"
    ) -> None:
        params = gtsam.ISAM2Params()
        params.setFactorization(factorisation)
        params.relinearizeSkip = 1
        params.findUnusedFactorSlots = True  # otherwise marginalised factors leave holes that are searched each time
        self._smoother = gtsam.IncrementalFixedLagSmoother(lag_s, params)
        self._chain = FrameChain(start, rig, RectifiedPair(rig, sigma_px))
        self._start_ns, self._lag_s = start.state.stamp_ns, lag_s
        self._seen_s: dict[int, float] = {}  # when each landmark in the state was seen last, by identity

    @property
    def landmarks(self) -> int:
        """Landmarks in the state."""
        return len(self._seen_s)

    @property
    def landmarks_made(self) -> int:
        """Landmarks that have ever been in the state; one that was removed and re-observed counts twice."""
        return self._chain.landmarks_made

    def process(
        self,
        features: StereoFeatures,
        identities: Identities,
        motion: gtsam.PreintegratedCombinedMeasurements | None,
    ) -> Pose:
        """Process a frame and return its pose T_map_body; a landmark is kept for the lag after its last observation.

        Args:
            features: stereo points of the frame.
            identities: which landmark each shows.
            motion: from the frame before, with Cholesky by `cholesky_motion`, with QR by `factors.Motion`; None for the
                first frame, which has the start's stamp.
        """
        now_s = (features.stamp_ns - self._start_ns) / NS_PER_S
        graph, values = self._chain.add(features, identities, motion)
        frame, keys = self._chain.frame, self._chain.landmark_keys
        stamps = {X(frame): now_s, V(frame): now_s, B(frame): now_s}
        for identity in identities.tolist():
            if identity in keys:
                stamps[keys[identity]] = self._seen_s[identity] = now_s
        self._smoother.update(graph, values, stamps)
        for identity in [i for i, seen_s in self._seen_s.items() if seen_s < now_s - self._lag_s]:
            del self._seen_s[identity], keys[identity]  # marginalised; if re-observed, it is a new one
        pose = self._smoother.calculateEstimatePose3(X(frame))
        self._chain.state = gtsam.NavState(pose, self._smoother.calculateEstimateVector(V(frame)))
        self._chain.bias = self._smoother.calculateEstimateConstantBias(B(frame))
        return to_pose(pose)


def cholesky_motion(samples: Sequence[ImuSample], imu: ImuConfig, start: NavState) -> Motion:
    """Return the motion between frames with noise large enough for GTSAM's Cholesky factorisation."""
    softer = dataclasses.replace(
        imu, gyro_bias_walk=CHOLESKY_WALK * imu.gyro_bias_walk, accel_bias_walk=CHOLESKY_WALK * imu.accel_bias_walk
    )
    return Motion(samples, softer, start, integration_sigma=CHOLESKY_INTEGRATION_SIGMA)


def _poses(graph: gtsam.NonlinearFactorGraph, optimum: gtsam.Values, stamps_ns: list[int]) -> Trajectory:
    """Return the poses with their marginal covariance, by iSAM2 because `gtsam.Marginals` knows only Cholesky."""
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    tree = gtsam.ISAM2(params)
    tree.update(graph, optimum)
    estimates = []
    for frame, stamp_ns in enumerate(stamps_ns):
        pose = optimum.atPose3(X(frame))
        covariance = to_pose_covariance(pose, tree.marginalCovariance(X(frame)))
        estimates.append(PoseEstimate(stamp_ns, to_pose(pose), covariance))
    return Trajectory.from_estimates(estimates)
