# SPDX-License-Identifier: Apache-2.0
"""The thesis's unscented filters: exact on a linear problem, and where and why they fail while ours do not.

The thesis reports that its UKF's covariance becomes indefinite despite diagonal loading, so that square roots were
taken by singular values; for the UKF this depends on beta alone, for the UHF on gamma.
With one pair of sigma points per column and the pairs' second differences q_i, the transformed covariance is a positive
semidefinite part plus (beta - alpha^2) s s^T, s = sum q_i. So beta = 2 keeps it definite for any centre weight
(3 - n)/3, and beta = 0 does not.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from uav_vslam.config import RigConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation import thesis_unscented
from uav_vslam.estimation.belief import landmark_rows
from uav_vslam.estimation.linearisation import Jacobians, PredictedObservation
from uav_vslam.estimation.models import MODELS
from uav_vslam.estimation.observation import point_jacobian
from uav_vslam.estimation.thesis_unscented import ThesisUnscentedFilter, bounded, definite
from uav_vslam.ins.propagation import propagate, transition
from uav_vslam.simulation.scenario import Scenario, SimulatedVehicle, simulate_vehicle

Array = NDArray[np.float64]

ALL = np.arange(12)
SCALED = 1e-9
THESIS_PX = float(np.sqrt(10.0))  # "a value of 10 on the diagonal element of the covariance"


@pytest.mark.parametrize("model", sorted(MODELS))
def test_on_a_linear_problem_the_thesis_ukf_is_the_kalman_filter(course, monkeypatch, model: str) -> None:
    """Camera and motion are replaced by their linearisations; two steps, all outputs compared."""
    unscented, kalman = course.flown(model, "thesis_ukf", frames=1), course.flown(model, "ekf", frames=1)
    unscented.mean, unscented.belief = kalman.mean, kalman.belief
    coordinates, m = MODELS[model](), kalman.vehicle
    for frame in (1, 2):
        start, increment = kalman.nav, course.increments[frame - 1]
        process = Jacobians().process(coordinates, start, kalman.belief, increment, course.imu)
        end = propagate(start, increment, gravity=course.imu.gravity)

        def linear_motion(nav, *_, start=start, end=end, F=process.F, **__):
            return coordinates.retract(end, np.zeros((0, 3)), F @ coordinates.local(start, nav))[0]

        def linear_camera(self, chi: Array, predicted: PredictedObservation) -> Array:
            own = chi[:, landmark_rows(m, predicted.landmarks)].reshape(len(chi), -1, 3)
            seen = np.einsum("nka,sa->snk", predicted.H_vehicle, chi[:, :m])
            seen += np.einsum("nka,sna->snk", predicted.H_landmark, own) + predicted.expected
            return seen.reshape(len(chi), -1)

        monkeypatch.setattr(thesis_unscented, "propagate", linear_motion)
        monkeypatch.setattr(ThesisUnscentedFilter, "_project", linear_camera)
        pixels = course.pixels(frame, ALL, np.random.default_rng(frame))
        innovations = []
        for f in (unscented, kalman):
            f.predict(increment)
            innovations.append(f.update(ALL, pixels))
        P = kalman.covariance()
        sigma = np.sqrt(np.diag(P))
        off = np.append(coordinates.local(kalman.nav, unscented.nav), (unscented.landmarks - kalman.landmarks).ravel())
        np.testing.assert_allclose(off / sigma, 0.0, rtol=0, atol=SCALED)
        error = unscented.covariance() - P
        np.testing.assert_allclose(error / np.outer(sigma, sigma), 0.0, rtol=0, atol=SCALED)
        a, b = innovations
        assert a.nis == pytest.approx(b.nis, rel=SCALED)


def unscented(points: Array, centre_weight: float) -> tuple[Array, Array]:
    """Return mean and deviations of (2n+1, k) images of sigma points, kappa = 3 - n; Eq. (4.3.2), (4.3.4)."""
    mean = centre_weight * points[0] + points[1:].sum(axis=0) / 6.0
    return mean, points - mean


@pytest.mark.parametrize("model", sorted(MODELS))
def test_prediction_and_update_follow_the_equations_of_the_thesis(course, model: str) -> None:
    """Eq. (4.3.6) and (4.3.7), with three times the uncertainty so that nonlinearity matters."""
    f, coordinates, none = course.flown(model, "thesis_ukf", frames=1), MODELS[model](), np.zeros((0, 3))
    course.set_covariance(f, 9.0 * f.covariance())
    m, n, increment = f.vehicle, f.belief.size, course.increments[1]
    centre_weight = (3.0 - n) / 3.0
    weights = np.append(centre_weight + 2.0, np.full(2 * n, 1.0 / 6.0))

    columns = np.linalg.cholesky(3.0 * f.covariance()).T
    chi = np.vstack([np.zeros(n), columns, -columns])
    centre = propagate(f.nav, increment, gravity=course.imu.gravity)
    ends = chi.copy()
    for k, start in enumerate(chi[:, :m]):
        moved, _ = coordinates.retract(f.nav, none, start)
        ends[k, :m] = coordinates.local(centre, propagate(moved, increment, gravity=course.imu.gravity))
    mean, D = unscented(ends, centre_weight)
    nav, landmarks = coordinates.retract(centre, f.landmarks, mean)
    P, (_, Q) = (D.T * weights) @ D, transition(f.nav, increment, course.imu)
    P[:m, :m] += coordinates.from_map(nav) @ Q @ coordinates.from_map(nav).T
    f.predict(increment)
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose((f.covariance() - P) / np.outer(sigma, sigma), 0.0, rtol=0, atol=SCALED)
    np.testing.assert_allclose(f.nav.T_map_body.matrix, nav.T_map_body.matrix, rtol=0, atol=SCALED)
    np.testing.assert_allclose(f.landmarks, landmarks, rtol=0, atol=SCALED)

    columns = np.linalg.cholesky(3.0 * f.covariance()).T
    chi, seen = np.vstack([np.zeros(n), columns, -columns]), []
    for error in chi:
        there, marks = coordinates.retract(f.nav, f.landmarks, error)
        seen.append(course.rig.project(point_jacobian(course.rig, there, marks).points_left).ravel())
    y, D = unscented(np.array(seen), centre_weight)
    S, P_xy = (D.T * weights) @ D + np.eye(len(y)), (chi.T * weights) @ D
    K = P_xy @ np.linalg.inv(S)
    pixels = course.pixels(2, ALL, np.random.default_rng(1))
    nu = pixels.ravel() - y
    before, marks = f.nav, f.landmarks
    innovation = f.update(ALL, pixels)
    assert innovation.nis == pytest.approx(float(nu @ np.linalg.solve(S, nu)), rel=1e-7)
    nav, landmarks = coordinates.retract(before, marks, K @ nu)
    np.testing.assert_allclose(f.nav.T_map_body.matrix, nav.T_map_body.matrix, rtol=0, atol=1e-7)
    np.testing.assert_allclose(f.landmarks, landmarks, rtol=0, atol=1e-6)
    if not coordinates.invariant:  # else transported, as `Filter` does after each correction
        P = P - K @ S @ K.T
        np.testing.assert_allclose((f.covariance() - P) / np.outer(sigma, sigma), 0.0, rtol=0, atol=1e-7)


def leftover(course, seed: int) -> float:
    """Return the smallest eigenvalue of the unscented covariance of a quadratic function, scaled to one."""
    rng = np.random.default_rng(seed)
    f = course.flown("ri15", "thesis_ukf", frames=1)
    chi, mean_weights, weights = f._sigma_points()
    A = rng.normal(size=(3, chi.shape[1])) / np.sqrt(np.diag(f.covariance()))
    y = (chi @ A.T) ** 2 + np.cos(chi @ A[::-1].T)
    D = y - mean_weights @ y
    S = (D.T * weights) @ D
    cross = (D.T * weights) @ chi
    values = np.linalg.eigvalsh(S - cross @ np.linalg.solve(f.covariance(), cross.T))
    return float(values[0] / np.abs(values).max())


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_with_the_beta_of_the_thesis_no_function_makes_the_covariance_indefinite(course, seed: int) -> None:
    assert leftover(course, seed) > -SCALED


def test_without_beta_a_quadratic_function_makes_it_indefinite(course, monkeypatch) -> None:
    monkeypatch.setattr(thesis_unscented, "BETA", 0.0)
    assert min(leftover(course, seed) for seed in range(5)) < -0.1


def flight(**truth) -> SimulatedVehicle:
    return simulate_vehicle(Scenario(**{"seed": 1, "frames": 25, "vehicles": 1, **truth}), 0)


def spectrum(rng: np.random.Generator, values: Array) -> Array:
    """Return a symmetric matrix with these eigenvalues."""
    V = np.linalg.qr(rng.normal(size=(len(values), len(values)))).Q
    return (V * values) @ V.T


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_the_bound_is_the_thesiss_equation_above_and_below_its_limit(seed: int, gamma: float) -> None:
    """Eq. (4.4.4) as printed, from the prior; gamma^2 is among, above or below the eigenvalues."""
    rng = np.random.default_rng(seed)
    P, H = spectrum(rng, rng.uniform(0.5, 20.0, 8)), rng.normal(size=(4, 8))
    P_xy, P_yy = P @ H.T, H @ P @ H.T
    left = np.hstack([P_xy, P])
    middle = np.block([[P_yy + np.eye(4), P_xy.T], [P_xy, P - gamma**2 * np.eye(8)]])
    after = P - P_xy @ np.linalg.solve(P_yy + np.eye(4), P_xy.T)
    assume(np.abs(np.linalg.eigvalsh(after) - gamma**2).min() > 1e-3)
    printed, found = P - left @ np.linalg.solve(middle, left.T), bounded(after, gamma)
    np.testing.assert_allclose(found, printed, rtol=0, atol=SCALED * np.abs(printed).max())
    infeasible = bool(np.linalg.eigvalsh(after)[-1] > gamma**2)
    assert infeasible == bool(np.linalg.eigvalsh(found)[0] < 0.0)


def flown(course, model: str, gamma: float | None) -> tuple[Array, Array]:
    """Return position and landmarks after three frames, and their covariance; without gamma those of the UKF."""
    name, options = ("thesis_ukf", {}) if gamma is None else ("thesis_uhf", {"gamma": gamma})
    f = course.flown(model, name, **options)
    f.update(ALL, course.pixels(3, ALL, np.random.default_rng(3)))
    return np.concatenate([f.nav.T_map_body.t, f.landmarks.ravel()]), f.covariance()


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_thesis_uhf_tends_to_its_ukf_as_gamma_squared(course, model: str) -> None:
    """Ten times the gamma leaves a hundredth of the difference; at infinity none is left."""
    mean, P = flown(course, model, None)
    sigma, away = np.sqrt(np.diag(P)), []
    for gamma in (1e2, 1e3, 1e9):
        bounded_mean, bounded_P = flown(course, model, gamma)
        away.append((np.abs(bounded_mean - mean).max(), np.abs((bounded_P - P) / np.outer(sigma, sigma)).max()))
    for far, near, none in zip(*away, strict=True):
        assert far > 1e-5  # the difference is not trivial
        assert near / far == pytest.approx(1e-2, rel=0.05)
        assert none < SCALED


@given(st.integers(0, 2**32 - 1))
def test_the_square_root_of_an_indefinite_covariance_has_its_singular_values(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.uniform(0.1, 5.0, 7) * np.where(np.arange(7) < 3, -1.0, 1.0)
    P = spectrum(rng, values)
    found = definite(P)
    np.testing.assert_allclose(np.linalg.eigvalsh(found), np.sort(np.abs(values)), rtol=SCALED)
    np.testing.assert_allclose(found @ P, P @ found, rtol=0, atol=SCALED)  # equal eigenvectors
    np.testing.assert_array_equal(definite(found), found)  # one with a Cholesky factor is left as it is


def test_a_covariance_that_is_not_finite_is_a_divergence() -> None:
    with pytest.raises(FilterDivergence, match="not finite"):
        definite(np.array([[1.0, np.nan], [np.nan, 1.0]]))


@pytest.mark.parametrize("name", ["thesis_ukf", "thesis_uhf"])
@pytest.mark.parametrize("model", sorted(MODELS))
def test_an_indefinite_covariance_still_gives_a_result(course, model: str, name: str) -> None:
    f = course.flown(model, name)
    values, V = np.linalg.eigh(f.covariance())
    values[[0, len(values) // 2]] *= -1.0
    course.set_covariance(f, (V * values) @ V.T)
    f.predict(course.increments[3])
    f.update(ALL, course.pixels(4, ALL, np.random.default_rng(4)))
    np.linalg.cholesky(f.covariance())
    np.testing.assert_allclose(f.nav.T_map_body.t, course.true_state(4).T_map_body.t, rtol=0, atol=2.0)


@pytest.fixture
def lowest(monkeypatch) -> list[float]:
    """The smallest eigenvalue of every covariance, before any remedy."""
    found = []

    def watched(P: Array) -> Array:
        found.append(float(np.linalg.eigvalsh(P)[0]))
        return definite(P)

    monkeypatch.setattr(thesis_unscented, "definite", watched)
    return found


@pytest.mark.parametrize("model", ["euler9", "ri15"])
def test_thesis_ukf_stays_definite_at_one_pixel_with_beta_and_not_without(fly, monkeypatch, lowest, model: str) -> None:
    """At 70 m with an ADIS16480."""
    assert fly(flight(), name="thesis_ukf", model=model).position_nees < 10.0
    assert min(lowest) > 0.0
    monkeypatch.setattr(thesis_unscented, "BETA", 0.0)
    fly(flight(frames=4), name="thesis_ukf", model=model)
    assert min(lowest) < -1e-3


@pytest.mark.parametrize("alpha", [1e-2, 1e-4])
def test_a_smaller_spread_changes_little(fly, monkeypatch, alpha: float) -> None:
    """alpha from 1e-4 to 1: weights of 1e9 cost digits, but not definiteness."""
    wide = fly(flight(frames=10), name="thesis_ukf")
    monkeypatch.setattr(thesis_unscented, "SPREAD", alpha * np.sqrt(3.0))
    monkeypatch.setattr(thesis_unscented, "BETA", 1.0 - alpha**2 + 2.0)
    narrow = fly(flight(frames=10), name="thesis_ukf")
    shift = wide.filter.nav.T_map_body.t - narrow.filter.nav.T_map_body.t
    sigma = np.sqrt(np.diag(wide.filter.nav_estimate().covariance)[:3])
    assert (np.abs(shift) < 0.2 * sigma).all()


@pytest.mark.parametrize("model", ["euler9", "ri15"])
def test_uncertain_landmarks_stop_the_thesis_ukf_and_not_ours(fly, model: str) -> None:
    """100 m up, with the thesis's 10 px^2, a new landmark's depth sigma is 35 m or more: its points, up to sqrt(3)
    sigmas away, are behind the camera. Ours use the Jacobian for such a landmark.
    """
    vehicle = flight(altitude=100.0)
    with pytest.raises(FilterDivergence, match="a sigma point puts a landmark behind the camera"):
        fly(vehicle, name="thesis_ukf", model=model, sigma_px=THESIS_PX)
    for name in ("ukf", "uhf"):
        assert fly(vehicle, name=name, model=model, sigma_px=THESIS_PX).position_nees < 4.0


@pytest.mark.parametrize("model", sorted(MODELS))
@pytest.mark.parametrize("imu", ["adis16480", "thesis_w1", "thesis_w4"])
def test_the_gamma_of_the_thesis_makes_the_covariance_indefinite_and_singular_values_go_on(
    fly, lowest, model: str, imu: str
) -> None:
    """gamma = 1.5 on the whole state is infeasible as soon as an error exceeds 1.5 m; ours raises it."""
    vehicle = flight(imu=imu)
    ended = fly(vehicle, name="thesis_uhf", model=model, gamma=1.5)
    assert min(lowest) < -0.1
    true = vehicle.true_state(int(vehicle.frame_stamps_ns[-1])).T_map_body.t
    assert np.linalg.norm(ended.filter.nav.T_map_body.t - true) < 5.0
    held = fly(flight(frames=4, imu=imu), name="uhf", model=model, gamma=1.5)
    assert held.filter.feasibility > 1.0


def test_the_thesis_filters_take_the_rig_as_exact(course) -> None:
    f = course.filter("euler9", "thesis_ukf", rig_config=RigConfig(flexing=True, time_offset_sigma_s=0.01))
    assert f.vehicle == 9


def test_steps_without_landmarks_and_observations_are_possible(course) -> None:
    f = course.filter("euler9", "thesis_ukf")
    f.predict(course.increments[0])
    innovation = f.update(np.zeros(0, np.int64), np.zeros((0, 4)))
    assert (innovation.nis, innovation.dof, innovation.accepted) == (0.0, 0, True)
    assert np.isfinite(f.nav_estimate().covariance).all()
