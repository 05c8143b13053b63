# SPDX-License-Identifier: Apache-2.0
"""IMU biases that step in flight are noticed, named, and do not make the filter confidently wrong."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from flown_copy import copy_of

from uav_vslam.config import ImuConfig
from uav_vslam.estimation.models import MODELS
from uav_vslam.ins.increments import unknown_motion_since
from uav_vslam.ins.preintegrator import advance
from uav_vslam.ins.propagation import corrected
from uav_vslam.slam.backend import SKIPPED_IDS
from uav_vslam.slam.bias_steps import SETTLED_S, _replayed, correction
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.stage import SlamStage
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, StereoFeatures

FRAMES, FIRST, SIGMA_PX = 76, 50, 0.05
GAP = range(2, 7)  # frames: 0.8 s without readings are a motion that is unknown
NOTICED = 15  # frames of 0.14 s after the step, at most
STEPS = {"gyro": ((0.0, 0.006, -0.008), (0.0, 0.0, 0.0)), "accel": ((0.0, 0.0, 0.0), (0.3, -0.4, 0.0))}


def stepped(increment: ImuIncrement, gyro: np.ndarray, accel: np.ndarray) -> ImuIncrement:
    """Return an increment whose readings are that much larger [rad/s], [m/s^2]."""
    deltas = corrected(increment, increment.gyro_bias - gyro, increment.accel_bias - accel)
    return dataclasses.replace(increment, **dict(zip(("delta_R", "delta_v", "delta_p"), deltas, strict=True)))


Flying = tuple[SlamStage, list[FrameOutput]]  # a stage, and its outputs so far


@pytest.fixture(scope="module")
def begun(flown) -> Callable[[], Flying]:
    """What returns the flight up to the step; each kind of step goes on with a copy."""
    flight = flown(320, frames=FRAMES, tracked_px=SIGMA_PX)
    stage, outputs = flight.tracking_stage(SIGMA_PX), list[FrameOutput]()
    fly((stage, outputs), flight, range(FIRST), "gyro")
    return lambda: (copy_of(stage), outputs.copy())


def fly(flying: Flying, flight, frames: range, kind: str, *, blank: range = range(0), lost: range = range(0)) -> None:
    """Fly on with biases that step at frame `FIRST`.

    The frames `blank` show nothing; the frames `lost` are missing, and the readings up to the next one.
    """
    (stage, outputs), (gyro, accel) = flying, np.array(STEPS[kind])
    for k in frames:
        if k in lost:
            continue
        features, increment = flight.frames[k]
        stage.add_features(StereoFeatures.empty(features.stamp_ns) if k in blank else features)
        if k == lost.stop and lost:
            before = dataclasses.replace(flight.vehicle.initial.state, stamp_ns=outputs[-1].report.pose.stamp_ns)
            increment = unknown_motion_since(before, features.stamp_ns, ImuConfig())
        if increment is not None:
            stage.add_increment(stepped(increment, gyro, accel) if k >= FIRST else increment)
        outputs += stage.run()


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "lost"), [("gyro", range(0)), ("accel", range(0)), ("gyro", GAP)])
def test_a_step_is_noticed_and_costs_nothing_for_long(flown, begun, kind: str, lost: range) -> None:
    """The position NEES per axis used to be above 100 for the rest of the flight."""
    flight, step = flown(320, frames=FRAMES, tracked_px=SIGMA_PX), np.array(STEPS[kind])
    assert flight.frames[FIRST][0].stamp_ns - flight.frames[0][0].stamp_ns > (SETTLED_S + 1.0) * NS_PER_S
    flying = (flight.tracking_stage(SIGMA_PX), []) if lost else begun()
    fly(flying, flight, range(0 if lost else FIRST, FRAMES), kind, lost=lost)
    outputs = flying[1]
    recoveries = [k for k, output in enumerate(outputs) if output.report.recovery]
    assert FIRST < recoveries[0] + len(lost) <= FIRST + NOTICED
    assert "biases have stepped" in outputs[recoveries[0]].warnings[-1]
    _, nees = flight.errors_and_nees(outputs)
    assert nees[recoveries[0] :].mean() < 2.0
    before, after = (outputs[k].report.nav.state for k in (FIRST - 1 - len(lost), -1))
    np.testing.assert_allclose(after.gyro_bias - before.gyro_bias, step[0], atol=5e-4)
    np.testing.assert_allclose(after.accel_bias - before.accel_bias, step[1], atol=0.05)


def test_a_step_is_noticed_among_frames_that_show_nothing(flown, begun) -> None:
    """None is left out when they are used once more; identifiers leave room for a restart from a checkpoint."""
    flight = flown(320, frames=FRAMES, tracked_px=SIGMA_PX)
    flying = begun()
    fly(flying, flight, range(FIRST, FIRST + NOTICED + 1), "gyro", blank=range(FIRST, FRAMES, 6))
    outputs = flying[1]
    found = [k for k, output in enumerate(outputs) if "biases have stepped" in output.report.recovery]
    assert found
    assert found[0] > FIRST
    known = [output.joint.ids for output in outputs if output.joint is not None]
    assert max(ids.max() for ids in known) < SKIPPED_IDS


def test_what_a_single_frame_shows_is_no_step(begun) -> None:
    """Where a second passes between images: whatever one shows, biases that may step explain it."""
    flight = begun()[0]._flight
    past = flight._bias_steps._past[0]
    since_ns = past.frames[-1][1].stamp_ns - past.frames[-3][1].stamp_ns
    for constant_s, is_found in ((0.75 * since_ns / NS_PER_S, True), (0.25 * since_ns / NS_PER_S, False)):
        found = _replayed(past, flight.backend, flight._config, constant_s=constant_s, significance=1.0)
        assert (found is not None) == is_found


def test_a_correction_that_its_covariance_allows_for_is_chi_square(flown) -> None:
    """Twelve degrees of freedom; what is negligible of the covariance makes it a little less."""
    rng, flight = np.random.default_rng(5), flown(321, frames=9)
    unaided = flight.vehicle.initial
    for _, increment in flight.frames[1:]:
        unaided = advance(unaided, increment, ImuConfig())
    P = 0.3 * unaided.covariance
    errors = np.linalg.cholesky(unaided.covariance - P) @ rng.normal(size=(15, 400))
    none = np.zeros((0, 3))
    moved = [NavEstimate(MODELS["ri15"]().retract(unaided.state, none, error)[0], P) for error in errors.T]
    assert 11.0 < np.mean([correction(nav, unaided) for nav in moved]) < 13.0
