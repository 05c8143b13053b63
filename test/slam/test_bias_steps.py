# SPDX-License-Identifier: Apache-2.0
"""IMU biases that step in flight are noticed, named, and do not make the filter confidently wrong."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import ImuConfig
from uav_vslam.estimation.models import MODELS
from uav_vslam.ins.preintegrator import advance
from uav_vslam.ins.propagation import corrected
from uav_vslam.slam.bias_steps import SETTLED_S, correction
from uav_vslam.slam.stage import FrameOutput
from uav_vslam.types import NS_PER_S, ImuIncrement, NavEstimate, StereoFeatures

FRAMES, FIRST, SIGMA_PX = 76, 50, 0.05
BLACK = FIRST - 2  # an image without points
NOTICED = 15  # frames of 0.14 s after the step, at most
STEPS = {"gyro": ((0.0, 0.006, -0.008), (0.0, 0.0, 0.0)), "accel": ((0.0, 0.0, 0.0), (0.3, -0.4, 0.0))}


def stepped(increment: ImuIncrement, gyro: np.ndarray, accel: np.ndarray) -> ImuIncrement:
    """Return an increment whose readings are that much larger [rad/s], [m/s^2]."""
    deltas = corrected(increment, increment.gyro_bias - gyro, increment.accel_bias - accel)
    return dataclasses.replace(increment, **dict(zip(("delta_R", "delta_v", "delta_p"), deltas, strict=True)))


@pytest.mark.parametrize("kind", STEPS)
def test_a_step_is_noticed_and_costs_nothing_for_long(flown, kind: str) -> None:
    """The position NEES per axis used to be above 100 for the rest of the flight."""
    flight, step = flown(320, frames=FRAMES, tracked_px=SIGMA_PX), tuple(np.array(part) for part in STEPS[kind])
    assert flight.frames[FIRST][0].stamp_ns - flight.frames[0][0].stamp_ns > (SETTLED_S + 1.0) * NS_PER_S
    stage, outputs = flight.tracking_stage(SIGMA_PX), list[FrameOutput]()
    for k, (features, increment) in enumerate(flight.frames):
        stage.add_features(StereoFeatures.empty(features.stamp_ns) if k == BLACK else features)
        if increment is not None:
            stage.add_increment(stepped(increment, *step) if k >= FIRST else increment)
        outputs += stage.run()
    recoveries = [k for k, output in enumerate(outputs) if output.report.recovery]
    assert FIRST < recoveries[0] <= FIRST + NOTICED
    assert "biases have stepped" in outputs[recoveries[0]].warnings[-1]
    _, nees = flight.errors_and_nees(outputs)
    assert nees[recoveries[0] :].mean() < 2.0
    before, after = (outputs[k].report.nav.state for k in (FIRST - 1, FRAMES - 1))
    np.testing.assert_allclose(after.gyro_bias - before.gyro_bias, step[0], atol=5e-4)
    np.testing.assert_allclose(after.accel_bias - before.accel_bias, step[1], atol=0.05)


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
