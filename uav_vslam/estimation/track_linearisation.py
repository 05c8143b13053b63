# SPDX-License-Identifier: Apache-2.0
"""Tracks linearised at another mean than the filter's, as what they say about the error of the filter's own mean.

After a long time without an image the velocity may be off by metres a second. Over low ground, the first tracks then
move the mean by a multiple of what a linearisation about it holds for: views that are exact to a hundredth of a pixel
make the state certain of what is off by ten sigma. So they are linearised again at the mean that they lead to, until
their residuals there are those that the linearisation predicts, as in an iterated Kalman filter; a step that would
leave larger residuals is shortened. About the filter's own mean the gate is so wide that an error of tens of sigma in a
view is none: so tracks that do not fit where they all lead are refused there.

Symbols: with the mean moved by delta, the error becomes e' = T (e - delta), and a residual r' = H' e' + noise is
r' + H' T delta = H' T e + noise. A point that becomes a landmark is at the filter's mean where its error about the
other one, for e = 0, puts it; its error is transported with it, or a common rotation would move it in the images.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.belief import Indices, VehicleObservation
from uav_vslam.estimation.mean import Chart, Mean
from uav_vslam.estimation.track_consensus import WIDE
from uav_vslam.estimation.tracks import TrackObservation
from uav_vslam.ins.propagation import ROTATION

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RELINEARISATIONS = 5  # at most
ROUNDS = 6  # at most, of leaving out what does not fit
SHORTER_STEPS = 3  # at most, each half as long as the one before
NONLINEAR = 1.0  # by which the squared residuals, over their noise, may exceed those predicted


@dataclass(frozen=True, slots=True)
class Move:
    """From the filter's mean, its landmarks left out, to another one.

    Attributes:
        chart: of the errors about both.
        before: the filter's mean.
        after: the other one.
        delta: (vehicle,) correction.
        T: (vehicle, vehicle) see above.
    """

    chart: Chart
    before: Mean
    after: Mean
    delta: Array
    T: Array

    @classmethod
    def by(cls, delta: Array, before: Mean, chart: Chart) -> Self:
        """Return the move from a mean by a correction."""
        after, T = chart.retract(before, delta), np.eye(len(delta))
        T[:, ROTATION] -= chart.transport(before, after)
        return cls(chart, before, after, delta, T)

    def back(self, points: Array, errors: Array) -> tuple[Array, Array]:
        """Return (K, 3) points, of (K, 3) errors about the other mean, where they are at the filter's [m].

        The second value transports their errors from there to the other mean: (K, 3, 3), see `Chart.transport`.
        """
        there = dataclasses.replace(self.after, landmarks=points)
        landmarks = self.chart.retract(there, np.concatenate([-self.T @ self.delta, errors.ravel()])).landmarks
        here = dataclasses.replace(self.before, landmarks=landmarks)
        return landmarks, self.chart.transport(here, there)[len(self.delta) :].reshape(-1, 3, 3)


@dataclass(frozen=True, slots=True)
class LinearisedTracks:
    """Tracks linearised at a mean.

    Attributes:
        seen: there.
        rows: of the vehicle's error, the columns of `seen.H`.
        vehicle: number of rows of the vehicle's error.
        move: from the filter's mean; None at that itself.
    """

    seen: TrackObservation
    rows: Indices
    vehicle: int
    move: Move | None = None

    def squared_residual(self, tracks: Mask) -> float:
        """Return the sum of some tracks' whitened squared residuals at the mean."""
        return self.seen.chosen(tracks).of_poses().norm2

    def of_vehicle(self, tracks: Mask) -> VehicleObservation:
        """Return what some tracks say about the error of the filter's mean."""
        said = self.seen.chosen(tracks).of_poses()
        Y, i = np.zeros((self.vehicle,) * 2), np.zeros(self.vehicle)
        Y[self.rows[:, None], self.rows], i[self.rows] = said.Y, said.i
        if self.move is None:
            return dataclasses.replace(said, Y=Y, i=i)
        T = self.move.T
        return dataclasses.replace(said, Y=T.T @ Y @ T, i=T.T @ i).about(self.move.delta)

    def misfits(self, said: VehicleObservation, P: Array, probability: float) -> Array:
        """Return (T,) `TrackObservation.misfits` where `said`, about the filter's mean of covariance P, leads."""
        mean = P @ _weighted(said, P)
        if self.move is not None:
            mean = self.move.T @ (mean - self.move.delta)
        return self.seen.misfits(mean[self.rows], probability)

    def of_points(self, tracks: Mask) -> tuple[Array, Array, Array]:
        """Return the points (K, 3) of some tracks, and what `Belief.appended` takes: (K, 3, vehicle) and (K, 3, 3)."""
        chosen = self.seen.chosen(tracks)
        H = np.zeros((len(chosen.points), 3, self.vehicle))
        H[..., self.rows] = chosen.of_points
        if self.move is None:
            return chosen.points, H, chosen.R
        H = H @ self.move.T
        errors = np.linalg.solve(chosen.R, (H @ self.move.delta)[..., None])[..., 0]
        points, B = self.move.back(chosen.points, np.asarray(errors))
        H[..., ROTATION] -= chosen.R @ B
        return points, H, chosen.R


def fitting(
    first: LinearisedTracks, used: Mask, P: Array, linearise: Callable[[Array], LinearisedTracks], probability: float
) -> tuple[Mask, LinearisedTracks, VehicleObservation]:
    """Return which tracks to use, and of these what `relinearised` returns; all, as they are, in a narrow gate.

    Those are used that fit where they lead, if they are a majority; otherwise none. Where wrong ones lead the others
    astray, the half that fits best leads next, as in least trimmed squares.

    Args:
        first, used, P, linearise: as for `relinearised`.
        probability: of the gate about the mean to which the tracks lead.
    """
    linearised, said = first, first.of_vehicle(used)
    if np.vdot(said.Y, P) < WIDE * used.sum():
        return used, linearised, said
    leading = used
    for _ in range(ROUNDS):
        linearised, said = relinearised(first, leading, P, linearise)
        misfits = linearised.misfits(said, P, probability)
        median = np.median(misfits[used])
        best = used & (misfits <= max(median, 1.0))
        if median <= 1.0 and (best == leading).all():
            return leading, linearised, said
        leading = best
    return np.zeros_like(used), linearised, said


def relinearised(
    first: LinearisedTracks, used: Mask, P: Array, linearise: Callable[[Array], LinearisedTracks]
) -> tuple[LinearisedTracks, VehicleObservation]:
    """Return tracks linearised at the mean that those used lead to, or as they are if those predict what is there.

    The second value is what those used say there about the error of the filter's mean.

    Args:
        first: linearised at the filter's mean.
        used: (T,) those that count.
        P: (vehicle, vehicle) covariance of the vehicle.
        linearise: linearises them where a correction (vehicle,) moves the filter's mean.
    """
    best, said = first, first.of_vehicle(used)

    def at(weighted: Array) -> tuple[LinearisedTracks, float, float]:
        """Return the tracks where P times a vector leads, their squared residual, and that with the prior's."""
        delta = P @ weighted
        there = linearise(delta)
        residual = there.squared_residual(used)
        return there, residual, residual + float(delta @ weighted)

    cost, reached = said.norm2, np.zeros(len(P))
    for _ in range(RELINEARISATIONS):
        weighted = _weighted(said, P)
        delta = P @ weighted
        predicted = said.norm2 - float(delta @ (2.0 * said.i - said.Y @ delta))
        there, residual, total = at(weighted)
        if residual - predicted < NONLINEAR:
            break
        for _ in range(SHORTER_STEPS):
            if total <= cost:
                break
            weighted = 0.5 * (reached + weighted)
            there, _, total = at(weighted)
        if total > cost:
            break
        best, said, cost, reached = there, there.of_vehicle(used), total, weighted
    return best, said


def _weighted(said: VehicleObservation, P: Array) -> Array:
    """Return (vehicle,) P^-1 times the correction to which observations lead a mean of covariance P."""
    return np.asarray(np.linalg.solve(np.eye(len(P)) + said.Y @ P, said.i), np.float64)
