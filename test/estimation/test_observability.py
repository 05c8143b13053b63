# SPDX-License-Identifier: Apache-2.0
"""Which filters preserve the unobservable directions of visual-inertial odometry: global position and yaw."""

import numpy as np
import pytest
from numpy.typing import NDArray

from uav_vslam.estimation.filter import Filter
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.rotation import so3_exp
from uav_vslam.ins.propagation import POSITION, ROTATION, VELOCITY

Array = NDArray[np.float64]


def unobservable(f: Filter) -> Array:
    """Return (n, 4) errors of shifts along x, y, z and of a yaw about z, at the current mean; 15-state models."""
    n = len(f.landmarks)
    N = np.zeros((15 + 3 * n, 4))
    up = np.array([0.0, 0.0, 1.0])
    N[POSITION, :3] = np.eye(3)
    N[15:, :3] = np.tile(np.eye(3), (n, 1))
    N[POSITION, 3] = np.cross(up, f.nav.T_map_body.t)
    N[VELOCITY, 3] = np.cross(up, f.nav.v_map)
    N[ROTATION, 3] = up
    N[15:, 3] = np.cross(up, f.landmarks).ravel()
    return N


def information_gained(
    course, name: str, model: str, *, known: float = 1e-6, smoothing: float = 0.0, relinearise: bool = False
) -> Array:
    """Fly from a nearly uninformative prior of the four directions; return the information gained on each.

    Args:
        course: the flight.
        name, model: of the filter.
        known: information of the prior along the four directions [1/m^2].
        smoothing: of the depth.
        relinearise: use another linearisation point for each update.
    """
    rng = np.random.default_rng(1)
    f = course.filter(model, name, depth_sigma_ratio=smoothing)
    N = unobservable(f)
    Q, _ = np.linalg.qr(N)
    ignorant = np.eye(15) - Q @ Q.T
    course.set_covariance(f, np.linalg.inv(ignorant @ np.linalg.inv(f.covariance()) @ ignorant + known * Q @ Q.T))
    start = information_along(f)
    f.add_landmarks(course.pixels(0, np.arange(8), rng))
    in_state = list(range(8))
    for frame in range(1, 8):
        f.predict(course.increments[frame - 1])
        elsewhere = _near(course.true_state(frame).T_map_body, rng) if relinearise else None
        f.update(np.arange(len(in_state)), course.pixels(frame, in_state, rng), linearise_at=elsewhere)
        if frame == 3:
            f.marginalise(np.array([1, 4]))
            in_state = [k for n, k in enumerate(in_state) if n not in (1, 4)]
        if frame == 4:
            f.add_landmarks(course.pixels(frame, np.arange(8, 12), rng))
            in_state += list(range(8, 12))
    return information_along(f) - start


def information_along(f: Filter) -> Array:
    N = unobservable(f)
    return np.asarray(np.diag(N.T @ f.belief.information(np.arange(f.belief.size)) @ N))


def _near(pose: Pose, rng: np.random.Generator) -> Pose:
    return Pose(so3_exp(rng.normal(0, 0.02, 3)) @ pose.R, pose.t + rng.normal(0, 1.0, 3))


# Rounding: entries of Y reach 1e6, and yaw sums them over levers of 30 m: 1e-16 * 1e6 and * 30^2, with a margin of 10.
NO_INFORMATION = np.array([1e-9, 1e-9, 1e-9, 1e-6])  # [1/m^2] three times, [1/rad^2]


@pytest.mark.parametrize("smoothing", [0.0, 0.043])
@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_the_invariant_filter_gains_no_global_position_and_yaw_information(course, name: str, smoothing: float) -> None:
    assert (information_gained(course, name, "ri15", smoothing=smoothing) < NO_INFORMATION).all()


@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_it_gains_none_either_with_other_linearisation_points(course, name: str) -> None:
    assert (information_gained(course, name, "ri15", relinearise=True) < NO_INFORMATION).all()


@pytest.mark.parametrize("name", ["ukf", "uhf"])
def test_the_invariant_unscented_filter_gains_next_to_none(course, name: str) -> None:
    """Observations are invariant to finite shifts and yaws of the world, and even terms cancel in the slope; third
    order remains. With 10 m and 29 degrees of uncertainty, the filter gains less than a hundredth of the prior.
    """
    gained = information_gained(course, name, "ri15", known=1e-2)
    assert (gained < 1e-2 * np.array([1e-2, 1e-2, 1e-2, 4.0])).all()


@pytest.mark.parametrize("name", ["eif", "ekf", "ukf", "uhf"])
def test_the_ordinary_filter_gains_spurious_yaw_information(course, name: str) -> None:
    gained = information_gained(course, name, "so15", known=1e-2)
    assert gained[3] > 100.0  # within a second: a yaw sigma below 6 degrees, without any measurement


@pytest.mark.parametrize("name", ["eif", "ekf"])
def test_even_the_ordinary_filter_gains_none_on_global_position(course, name: str) -> None:
    gained = information_gained(course, name, "so15")  # shifts are linear
    assert (gained[:3] < NO_INFORMATION[:3]).all()
