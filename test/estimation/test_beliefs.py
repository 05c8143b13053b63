# SPDX-License-Identifier: Apache-2.0
"""One Gaussian in three forms: single operations and sequences against a dense textbook Kalman filter.

EKF = EIF = KF in correction, covariance, NIS and log-determinant. Comparisons are in scaled units:
covariances as correlations, corrections in sigmas of the prior, information in units of the inverse sigmas.
"""

import copy
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)
from numpy.typing import NDArray

from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation import information
from uav_vslam.estimation.belief import (
    Belief,
    Marginals,
    Observation,
    Update,
    VehicleObservation,
    add_normal_equations,
    landmark_rows,
    state_rows,
)
from uav_vslam.estimation.covariance import CovarianceBelief
from uav_vslam.estimation.information import InformationBelief
from uav_vslam.estimation.square_root import SquareRootBelief
from uav_vslam.numerics import cholesky

Array = NDArray[np.float64]

FORMS = (InformationBelief, CovarianceBelief, SquareRootBelief)
SCALED = 1e-9  # rounding of 1e-16 times condition numbers up to 1e5, with a margin
NONE = np.zeros(0, np.int64)


@dataclasses.dataclass(frozen=True)
class Dense:
    """The textbook form: one full covariance, each operation by its definition, with explicit inverses."""

    P: Array
    vehicle: int

    @property
    def landmarks(self) -> int:
        return (len(self.P) - self.vehicle) // 3

    def predicted(self, F: Array, Q: Array) -> "Dense":
        whole, noise, k = np.eye(len(self.P)), np.zeros_like(self.P), len(F)
        whole[:k, :k], noise[:k, :k] = F, Q
        return Dense(whole @ self.P @ whole.T + noise, self.vehicle)

    def cloned(self, rows: Array, variance: Array) -> "Dense":
        more = np.vstack([np.eye(self.vehicle, len(self.P)), np.eye(len(self.P))[rows]])
        whole = np.vstack([more, np.eye(len(self.P))[self.vehicle :]])
        noise = np.zeros(len(whole))
        noise[self.vehicle : self.vehicle + len(rows)] = variance
        return Dense(whole @ self.P @ whole.T + np.diag(noise), self.vehicle + len(rows))

    def reset_rows(self, rows: Array, variance: float) -> "Dense":
        P = self.P.copy()
        P[rows], P[:, rows] = 0.0, 0.0
        P[rows, rows] = variance
        return Dense(P, self.vehicle)

    def column(self, row: int) -> Array:
        return self.P[:, row]

    def information_changed(self, row: int, change: float) -> "Dense":
        Y = np.linalg.inv(self.P)
        Y[row, row] += change
        return Dense(np.linalg.inv(Y), self.vehicle)

    def information_removed(self, B: Array) -> "Dense":
        Y = np.linalg.inv(self.P)
        Y[: self.vehicle, : self.vehicle] -= B.T @ B
        return Dense(np.linalg.inv(Y), self.vehicle)

    def updated(self, observation: Observation) -> tuple["Dense", Array, float]:
        """Return the posterior, the correction and the NIS."""
        H = dense_jacobian(observation, len(self.P))
        S = H @ self.P @ H.T + np.eye(len(H))
        K = self.P @ H.T @ np.linalg.inv(S)
        nu = observation.nu.ravel()
        if observation.of_vehicle is not None:
            nu = np.concatenate([nu, observation.of_vehicle.rows()[1]])
        I_KH = np.eye(len(self.P)) - K @ H
        after = I_KH @ self.P @ I_KH.T + K @ K.T
        return Dense(after, self.vehicle), K @ nu, float(nu @ np.linalg.solve(S, nu))

    def appended(self, H_vehicle: Array, H_landmark: Array) -> "Dense":
        """0 = H_vehicle e_vehicle + H_landmark e_landmark + noise, solved for each new landmark."""
        P = self.P
        for Hv, Hl in zip(H_vehicle, H_landmark, strict=True):
            A = np.hstack([-np.linalg.inv(Hl) @ Hv, np.zeros((3, len(P) - self.vehicle))])
            P = np.block([[P, P @ A.T], [A @ P, A @ P @ A.T + np.linalg.inv(Hl.T @ Hl)]])
        return Dense(P, self.vehicle)

    def marginalised(self, landmarks: Array, vehicle_rows: Array = NONE) -> "Dense":
        gone = np.concatenate([vehicle_rows, landmark_rows(self.vehicle, landmarks)])
        return Dense(np.delete(np.delete(self.P, gone, axis=0), gone, axis=1), self.vehicle - len(vehicle_rows))

    def coordinates_changed(self, B: Array, columns: slice) -> "Dense":
        T = np.eye(len(self.P))
        T[:, columns] -= B
        return Dense(T @ self.P @ T.T, self.vehicle)


def dense_jacobian(observation: Observation, size: int) -> Array:
    count, k, m = observation.H_vehicle.shape
    H = np.zeros((count, k, size))
    H[:, :, :m] = observation.H_vehicle
    for n, landmark in enumerate(observation.landmarks):
        H[n, :, m + 3 * landmark : m + 3 * landmark + 3] = observation.H_landmark[n]
    rows = H.reshape(-1, size)
    if observation.of_vehicle is None:
        return rows
    return np.vstack([rows, np.pad(observation.of_vehicle.rows()[0], ((0, 0), (0, size - m)))])


def assert_holds(belief: Belief, dense: Dense) -> None:
    """Compare the full covariance and the vehicle's, without changing what the belief caches."""
    sigma, m = np.sqrt(np.diag(dense.P)), dense.vehicle
    error = copy.copy(belief).covariance(np.arange(dense.landmarks)) - dense.P
    np.testing.assert_allclose(error / np.outer(sigma, sigma), 0.0, rtol=0, atol=SCALED)
    error = copy.copy(belief).covariance(NONE) - dense.P[:m, :m]
    np.testing.assert_allclose(error / np.outer(sigma, sigma)[:m, :m], 0.0, rtol=0, atol=SCALED)
    assert (belief.vehicle, belief.size) == (dense.vehicle, len(dense.P))


def assert_marginals(found: Marginals, dense: Dense, landmarks: NDArray[np.int64]) -> None:
    """Compare the marginals of the vehicle and some landmarks."""
    sigma, m = np.sqrt(np.diag(dense.P)), dense.vehicle
    own = landmark_rows(m, landmarks).reshape(-1, 3)
    error = found.vehicle - dense.P[:m, :m]
    np.testing.assert_allclose(error / np.outer(sigma[:m], sigma[:m]), 0.0, rtol=0, atol=SCALED)
    error = found.cross - dense.P[:m, own].transpose(1, 0, 2)
    np.testing.assert_allclose(error / (sigma[:m, None] * sigma[own][:, None, :]), 0.0, rtol=0, atol=SCALED)
    error = found.landmarks - dense.P[own[:, :, None], own[:, None, :]]
    np.testing.assert_allclose(error / (sigma[own][:, :, None] * sigma[own][:, None, :]), 0.0, rtol=0, atol=SCALED)


def updated_like(belief: Belief, dense: Dense, observation: Observation) -> tuple[Belief, Dense]:
    """Update both and compare all outputs."""
    update, (after, delta, nis) = belief.updated(observation), dense.updated(observation)
    np.testing.assert_allclose((update.delta - delta) / np.sqrt(np.diag(dense.P)), 0.0, rtol=0, atol=SCALED)
    assert update.nis == pytest.approx(nis, rel=SCALED, abs=SCALED)
    assert_holds(update.belief, after)
    return update.belief, after


class Draw:
    """Well-conditioned random problems of given sizes."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def rotation(self, n: int) -> Array:
        return np.linalg.qr(self.rng.normal(size=(n, n)))[0]

    def matrix(self, n: int, low: float, high: float) -> Array:
        """Return (n, n) with singular values within a range."""
        return (self.rotation(n) * self.rng.uniform(low, high, n)) @ self.rotation(n)

    def covariance(self, n: int, rank: int) -> Array:
        root = self.rotation(n)[:, :rank] * self.rng.uniform(0.3, 3.0, rank)
        return root @ root.T

    def choice(self, count: int, share: float | None = None) -> NDArray[np.int64]:
        """Return some of `count` numbers, possibly none or all, in random order."""
        kept = self.rng.integers(0, count + 1) if share is None else round(share * count)
        return self.rng.permutation(count)[:kept]

    def observation(self, dense: Dense, landmarks: NDArray[np.int64]) -> Observation:
        k = int(self.rng.integers(1, 5))
        shape = (len(landmarks), k)
        return Observation(
            landmarks,
            self.rng.normal(size=(*shape, dense.vehicle)),
            self.rng.normal(size=(*shape, 3)),
            self.rng.normal(0.0, 3.0, shape),
        )

    def process(self, m: int) -> tuple[Array, Array]:
        """Return F (m, m), well-conditioned, and Q (m, m) of any rank, zero included."""
        return self.matrix(m, 0.9, 1.1), self.covariance(m, int(self.rng.integers(0, m + 1)))

    def bound(self, dense: Dense) -> Array:
        """Return B (k, vehicle) with B P B^T at half its feasibility limit."""
        B = self.rng.normal(size=(int(self.rng.integers(1, dense.vehicle + 1)), dense.vehicle))
        P = dense.P[: dense.vehicle, : dense.vehicle]
        return B * np.sqrt(0.5 / np.linalg.eigvalsh(B @ P @ B.T)[-1])

    def chart_transport(self, dense: Dense) -> tuple[Array, slice]:
        start = int(self.rng.integers(0, dense.vehicle - 2))
        B = self.rng.normal(0.0, 0.3, (len(dense.P), 3))
        B[start : start + 3] = 0.0
        return B, slice(start, start + 3)

    def fresh(self, dense: Dense, count: int) -> tuple[Array, Array]:
        H_landmark = np.array([self.matrix(3, 0.5, 2.0) for _ in range(count)]).reshape(count, 3, 3)
        return self.rng.normal(size=(count, 3, dense.vehicle)), H_landmark

    def belief(self, form: type[Belief], m: int, landmarks: int) -> tuple[Belief, Dense]:
        """Return a correlated vehicle and landmarks, in the given form and dense."""
        P = self.covariance(m, m)
        fresh = self.fresh(Dense(P, m), landmarks)
        return form.from_covariance(P).appended(*fresh), Dense(P, m).appended(*fresh)


SEEDS = st.integers(0, 2**32 - 1)
VEHICLE = st.integers(3, 9)
LANDMARKS = st.integers(0, 6)
FEW = settings(max_examples=30)  # each is a random problem; the sequences below add many more


@pytest.fixture(scope="module", params=FORMS, ids=lambda form: form.__name__)
def form(request: pytest.FixtureRequest) -> type[Belief]:
    return request.param


@FEW
@given(SEEDS, VEHICLE)
def test_the_initial_covariance_is_the_given_one(form: type[Belief], seed: int, m: int) -> None:
    P = Draw(seed).covariance(m, m)
    dense = Dense(P.copy(), m)
    belief = form.from_covariance(P)
    np.testing.assert_array_equal(P, dense.P)
    P[:] = np.nan  # the belief must own a copy
    assert_holds(belief, dense)


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_prediction_is_F_P_Ft_plus_Q_even_for_singular_Q(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    F, Q = draw.process(m)
    assert_holds(belief.predicted(F, Q), dense.predicted(F, Q))
    assert_holds(belief.predicted(F, np.zeros((m, m))), dense.predicted(F, np.zeros((m, m))))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_prediction_may_concern_the_first_rows_alone(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    F, Q = draw.process(m - 1)
    assert_holds(belief.predicted(F, Q), dense.predicted(F, Q))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_copies_of_rows_stay_when_the_originals_move_on_and_can_go(
    form: type[Belief], seed: int, m: int, n: int
) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    rows = draw.choice(m)
    variance = np.linspace(0.1, 0.3, len(rows))
    copied, dense_copied = belief.cloned(rows, variance), dense.cloned(rows, variance)
    assert_holds(copied, dense_copied)
    process = draw.process(m)
    moved, dense_moved = copied.predicted(*process), dense_copied.predicted(*process)
    assert_holds(moved, dense_moved)
    copies = m + np.arange(len(rows))
    assert_holds(moved.marginalised(NONE, copies), dense_moved.marginalised(NONE, copies))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_update_uses_observations_of_the_vehicle_alone(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    rng = np.random.default_rng(seed)
    H, nu = rng.normal(size=(m - 1, m)), rng.normal(size=m - 1)
    of_vehicle = VehicleObservation(H.T @ H, H.T @ nu, float(nu @ nu), len(nu))
    rows, reduced, excess = of_vehicle.rows()
    np.testing.assert_allclose(rows.T @ rows, H.T @ H, atol=1e-9)
    np.testing.assert_allclose(rows.T @ reduced, H.T @ nu, atol=1e-9)
    assert (len(rows), excess) == (m - 1, pytest.approx(0.0, abs=1e-9))
    for landmarks in (draw.choice(n), NONE):
        seen = dataclasses.replace(draw.observation(dense, landmarks), of_vehicle=of_vehicle)
        updated_like(belief, dense, seen)


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_reset_rows_are_independent_of_all_others(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    rows = draw.choice(m)
    assert_holds(belief.reset_rows(rows, 0.7), dense.reset_rows(rows, 0.7))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_information_is_removed(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    B = draw.bound(dense)
    assert_holds(belief.information_removed(B), dense.information_removed(B))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS, st.floats(-0.9, 10.0))
def test_information_is_added_to_a_row_or_taken_away(
    form: type[Belief], seed: int, m: int, n: int, share: float
) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    row = seed % m
    change = share / dense.P[row, row]
    after, expected = (b.information_changed(row, change) for b in (belief, dense))
    assert_holds(after, expected)
    scale = np.sqrt(np.diag(expected.P) * expected.P[row, row])
    np.testing.assert_allclose((after.column(row) - expected.column(row)) / scale, 0.0, rtol=0, atol=SCALED)


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_update_is_the_kalman_update_in_every_output(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    updated_like(belief, dense, draw.observation(dense, draw.choice(n)))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS, st.integers(0, 3))
def test_new_landmarks_inherit_the_vehicles_uncertainty(
    form: type[Belief], seed: int, m: int, n: int, new: int
) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    fresh = draw.fresh(dense, new)
    assert_holds(belief.appended(*fresh), dense.appended(*fresh))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_marginalising_drops_rows_of_the_covariance(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    for gone in (draw.choice(n), NONE, np.arange(n)):
        assert_holds(belief.marginalised(gone), dense.marginalised(gone))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_coordinates_are_changed(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    B, columns = draw.chart_transport(dense)
    assert_holds(belief.coordinates_changed(B, columns), dense.coordinates_changed(B, columns))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_covariance_has_its_rows_in_the_requested_order(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    for _ in range(3):
        chosen = draw.choice(n)
        rows = state_rows(m, chosen)
        np.testing.assert_allclose(belief.covariance(chosen), dense.P[np.ix_(rows, rows)], rtol=SCALED, atol=1e-8)


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_marginals_are_the_blocks_of_the_covariance_in_the_requested_order(
    form: type[Belief], seed: int, m: int, n: int
) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    for _ in range(3):  # the information form caches the first and serves subsets from it
        chosen = draw.choice(n)
        assert_marginals(belief.marginals(chosen), dense, chosen)


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_information_is_the_inverse_of_the_covariance_block(form: type[Belief], seed: int, m: int, n: int) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    rows = np.append(draw.choice(dense.P.shape[0] - 1), len(dense.P) - 1)
    expected = np.linalg.inv(dense.P[np.ix_(rows, rows)])
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(belief.information(rows) / scale, expected / scale, rtol=0, atol=SCALED)


@FEW
@given(SEEDS, VEHICLE, st.integers(1, 6))
def test_the_order_of_observations_does_not_matter(form: type[Belief], seed: int, m: int, n: int) -> None:
    """In one batch, and in consecutive batches, whose corrections add up."""
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    seen = draw.observation(dense, draw.rng.permutation(n))
    at_once = belief.updated(seen)
    order = draw.rng.permutation(n)
    assert_same_update(belief.updated(part(seen, order)), at_once, dense)
    delta, nis, after = np.zeros(len(dense.P)), 0.0, belief
    for places in np.array_split(order, 3):
        some = part(seen, places)
        update = after.updated(dataclasses.replace(some, nu=some.nu - some.apply(delta)))
        after, delta, nis = update.belief, delta + update.delta, nis + update.nis
    assert_same_update(Update(after, delta, nis), at_once, dense)


def part(seen: Observation, places: NDArray[np.int64]) -> Observation:
    return Observation(seen.landmarks[places], seen.H_vehicle[places], seen.H_landmark[places], seen.nu[places])


def assert_same_update(update: Update, expected: Update, dense: Dense) -> None:
    np.testing.assert_allclose((update.delta - expected.delta) / np.sqrt(np.diag(dense.P)), 0.0, rtol=0, atol=SCALED)
    assert update.nis == pytest.approx(expected.nis, rel=SCALED, abs=SCALED)
    assert_holds(update.belief, Dense(expected.belief.covariance(np.arange(dense.landmarks)), dense.vehicle))


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_information_adds(seed: int, m: int, n: int) -> None:
    """Eq. (4.5.4): at a fixed linearisation an update of the information form is a sum."""
    draw = Draw(seed)
    belief, dense = draw.belief(InformationBelief, m, n)
    seen = draw.observation(dense, draw.choice(n))
    H = dense_jacobian(seen, len(dense.P))
    Y = belief.updated(seen).belief.Y
    np.testing.assert_allclose(Y, belief.Y + H.T @ H, rtol=1e-12, atol=1e-12)


@FEW
@given(SEEDS, VEHICLE, LANDMARKS)
def test_operations_modify_neither_the_belief_nor_their_arguments(
    form: type[Belief], seed: int, m: int, n: int
) -> None:
    draw = Draw(seed)
    belief, dense = draw.belief(form, m, n)
    (F, Q), (B, columns), bound = draw.process(m), draw.chart_transport(dense), draw.bound(dense)
    seen, fresh, gone = draw.observation(dense, draw.choice(n)), draw.fresh(dense, 2), draw.choice(n)
    arrays = [F, Q, B, bound, *fresh, gone, seen.landmarks, seen.H_vehicle, seen.H_landmark, seen.nu]
    before = [a.copy() for a in arrays]
    for operate in (
        lambda b: b.predicted(F, Q),
        lambda b: b.updated(seen).belief,
        lambda b: b.coordinates_changed(B, columns),
        lambda b: b.information_removed(bound),
        lambda b: b.information_changed(0, 1.0 / dense.P[0, 0]),
        lambda b: b.reset_rows(np.arange(2), 1.0),
        lambda b: b.appended(*fresh),
        lambda b: b.marginalised(gone),
    ):
        corrupt(operate(belief).covariance(NONE))
        corrupt(belief.covariance(np.arange(n)))
        marginals = belief.marginals(np.arange(n))
        for returned in (marginals.vehicle, marginals.cross, marginals.landmarks, belief.column(0)):
            corrupt(returned)
        np.testing.assert_allclose(belief.marginals(NONE).vehicle, dense.P[:m, :m], rtol=SCALED, atol=1e-8)
        assert_holds(belief, dense)
    for now, then in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_one_factor_of_the_whole_serves_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest landmarks leave view and are removed, new ones are added; none is needed that was out of use."""
    draw, factorised = Draw(1), []

    def counted(A: Array, what: str) -> Array:
        factorised.append(len(A))
        return cholesky(A, what)

    monkeypatch.setattr(information, "cholesky", counted)
    belief, dense = draw.belief(InformationBelief, 4, 8)
    for frame in range(3):
        in_view = np.arange(3, 8)
        assert_marginals(belief.marginals(in_view), dense, in_view)
        factorised.clear()
        belief, dense = updated_like(belief, dense, draw.observation(dense, in_view))
        steps = (
            ("coordinates_changed", draw.chart_transport(dense)),
            ("marginalised", (np.array([0, 2]),)),
            ("appended", draw.fresh(dense, 2)),
            ("predicted", draw.process(4)),
        )
        for name, arguments in steps:
            belief, dense = getattr(belief, name)(*arguments), getattr(dense, name)(*arguments)
        in_use = np.arange(1, 8)
        assert_marginals(belief.marginals(in_use), dense, in_use)
        assert [size for size in factorised if size > belief.size // 2] == [belief.size], frame


def test_an_indefinite_matrix_is_rejected(form: type[Belief]) -> None:
    with pytest.raises(FilterDivergence, match="smallest eigenvalue -1"):
        form.from_covariance(np.diag([1.0, -1.0, 1.0]))
    belief = form.from_covariance(np.eye(4))
    too_much = np.array([[0.0, 1.01, 0.0, 0.0]])  # more information than the belief has
    with pytest.raises(FilterDivergence, match="not positive definite"):
        belief.information_removed(too_much).covariance(NONE)
    with pytest.raises(FilterDivergence):
        belief.information_changed(0, -1.01 / belief.covariance(NONE)[0, 0]).covariance(NONE)


def test_normal_equations_are_those_of_the_dense_jacobian() -> None:
    draw = Draw(3)
    _, dense = draw.belief(CovarianceBelief, 4, 5)
    seen = draw.observation(dense, np.array([3, 0, 4]))
    H = dense_jacobian(seen, len(dense.P))
    Y = np.eye(len(dense.P))
    i = add_normal_equations(Y, seen, seen.landmarks)
    np.testing.assert_allclose(Y, np.eye(len(Y)) + H.T @ H, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(i, H.T @ seen.nu.ravel(), rtol=1e-13, atol=1e-13)


def corrupt(A: Array) -> None:
    """Corrupt the returned arrays where they are writeable."""
    if A.flags.writeable:
        A[:] = np.nan


class Sequences(RuleBasedStateMachine):
    """Random sequences of operations on all three forms; `query` and updates fill the information form's caches."""

    @initialize(seed=SEEDS, m=VEHICLE, n=LANDMARKS)
    def begin(self, seed: int, m: int, n: int) -> None:
        self.draw = Draw(seed)
        beliefs = [Draw(seed).belief(form, m, n) for form in FORMS]
        self.beliefs, self.dense = [belief for belief, _ in beliefs], beliefs[0][1]

    def _each(self, name: str, *arguments) -> None:
        self.beliefs = [getattr(belief, name)(*arguments) for belief in self.beliefs]
        self.dense = getattr(self.dense, name)(*arguments)

    @rule()
    def predict(self) -> None:
        self._each("predicted", *self.draw.process(self.dense.vehicle))

    @rule()
    def reset_rows(self) -> None:
        self._each("reset_rows", self.draw.choice(self.dense.vehicle), 0.5)

    @rule()
    def remove_information(self) -> None:
        """Skipped if ill-conditioned: each call doubles the condition number."""
        sigma = np.sqrt(np.diag(self.dense.P))
        if np.linalg.cond(self.dense.P / np.outer(sigma, sigma)) < 1e5:
            self._each("information_removed", self.draw.bound(self.dense))

    @rule()
    def chart_transport(self) -> None:
        self._each("coordinates_changed", *self.draw.chart_transport(self.dense))

    @rule(count=st.integers(0, 2))
    def append(self, count: int) -> None:
        if self.dense.landmarks < 10:
            self._each("appended", *self.draw.fresh(self.dense, count))

    @rule()
    def marginalise(self) -> None:
        self._each("marginalised", self.draw.choice(self.dense.landmarks)[:2])

    @rule()
    def query(self) -> None:
        """Query the covariance and marginals of some landmarks; the next update may concern others."""
        chosen = self.draw.choice(self.dense.landmarks)
        rows = state_rows(self.dense.vehicle, chosen)
        sigma = np.sqrt(np.diag(self.dense.P)[rows])
        for belief in self.beliefs:
            error = belief.covariance(chosen) - self.dense.P[np.ix_(rows, rows)]
            np.testing.assert_allclose(error / np.outer(sigma, sigma), 0.0, rtol=0, atol=SCALED)
            assert_marginals(belief.marginals(chosen), self.dense, chosen)

    @rule()
    def update(self) -> None:
        seen = self.draw.observation(self.dense, self.draw.choice(self.dense.landmarks))
        outcomes = [updated_like(belief, self.dense, seen) for belief in self.beliefs]
        self.beliefs, self.dense = [belief for belief, _ in outcomes], outcomes[0][1]

    @invariant()
    def all_hold_the_same(self) -> None:
        every = np.arange(self.dense.landmarks)
        for belief in self.beliefs:
            assert_holds(belief, self.dense)
            for some in (every, every[-2:]):  # the information form may know the newest only
                assert_marginals(copy.copy(belief).marginals(some), self.dense, some)
        alone = self.beliefs[0]
        assert_holds(InformationBelief(alone.Y, alone.vehicle), self.dense)


@pytest.mark.slow
def test_sequences_of_operations_agree_with_the_textbook() -> None:
    """The textbook continues from its own covariance, so errors must not accumulate either."""
    run_state_machine_as_test(Sequences, settings=settings(max_examples=60, stateful_step_count=25))
