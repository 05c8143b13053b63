# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment [triggs00]: robust least squares over poses, points and lenses, by Levenberg and Marquardt.

Points are eliminated (Schur complement), so that a dense system of the cameras alone is solved. Reprojection errors are
Huber's [huber64], positions known by GPS Cauchy's: a wrong one loses its pull. A camera's parameters are the rotation
vector of R_cam_map <- Exp(d) R_cam_map and its centre in the map frame.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array

from uav_vslam.geometry.rotation import skew, so3_exp
from uav_vslam.mapping.pictures.lens import PARAMETERS, project, project_jacobians
from uav_vslam.mapping.pictures.tracks import Tracks

Array = NDArray[np.float64]

POSE = 6
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING, DAMPING_STEP = 1e-4, 1e-9, 1e6, 8.0
MAX_STEPS = 40  # trials, refused ones included
LEAST_GAIN = 1e-5  # relative decrease of the cost below which the adjustment has converged
TINY = 1e-12
HELD = 1e18  # information of a lens parameter that stays


@dataclass(frozen=True, slots=True)
class Scene:
    """What is adjusted.

    Attributes:
        R_cam_map: (N, 3, 3) attitudes.
        centres: (N, 3) camera centres in the map frame.
        lenses: (G, 5) parameters of each camera's lens, as in `lens`.
        lens_of: (N,) camera of each picture.
        points: (P, 3) in the map frame.
    """

    R_cam_map: Array
    centres: Array
    lenses: Array
    lens_of: NDArray[np.intp]
    points: Array

    def in_camera(self, tracks: Tracks) -> Array:
        """Return the (M, 3) observed points in their cameras."""
        apart = self.points[tracks.point] - self.centres[tracks.picture]
        return np.einsum("mij,mj->mi", self.R_cam_map[tracks.picture], apart)

    def residuals(self, tracks: Tracks) -> Array:
        """Return (M, 2) reprojection errors [px]; pixels of the tracks are from the images' centres."""
        return project(self.in_camera(tracks), self.lenses[self.lens_of[tracks.picture]]) - tracks.pixels


@dataclass(frozen=True, slots=True)
class Priors:
    """What is known beside the pictures.

    Attributes:
        lenses: (G, 5) expected parameters.
        lens_sigmas: (G, 5) standard deviations; 0 holds a parameter fixed.
        positions: (N, 3) camera centres by GPS; NaN rows are unknown.
        position_sigmas: (3,) of an agreeing position.
    """

    lenses: Array
    lens_sigmas: Array
    positions: Array
    position_sigmas: Array


@dataclass(frozen=True, slots=True)
class _Normal:
    """Normal equations: cameras U, points V, mixed W, and gradients."""

    U: csr_array
    V: Array
    W: csr_array
    gradient: Array
    point_gradient: Array


class Bundle:
    """The adjustment of one set of observations."""

    def __init__(self, tracks: Tracks, priors: Priors, *, huber_px: float, noise_px: float = 1.0) -> None:
        """Prepare.

        Args:
            tracks: observations, ordered by point, in pixels from the images' centres.
            priors: of lenses and positions.
            huber_px: reprojection error from which the cost grows linearly.
            noise_px: standard deviation of a reprojection error, against which the priors weigh.
        """
        self._tracks, self._priors, self._huber_px, self._variance = tracks, priors, huber_px, noise_px**2
        self._starts = np.searchsorted(tracks.point, np.arange(tracks.count))

    def adjust(self, scene: Scene) -> Scene:
        """Return the scene of least cost near the given one.

        Raises:
            PictureError: the pictures do not determine the scene.
        """
        damping, cost = FIRST_DAMPING, self.cost(scene)
        normal = self._normal(scene)
        for _ in range(MAX_STEPS):
            trial = self._moved(scene, *_step(normal, damping))
            trial_cost = self.cost(trial)
            if not trial_cost < cost:
                damping *= DAMPING_STEP
                if damping > MOST_DAMPING:
                    break
                continue
            gain = 1.0 - trial_cost / cost
            scene, cost, damping = trial, trial_cost, max(damping / DAMPING_STEP, LEAST_DAMPING)
            if gain < LEAST_GAIN:
                break
            normal = self._normal(scene)
        return scene

    def cost(self, scene: Scene) -> float:
        """Return the robust cost: half the squared reprojection errors [px^2], and the priors in proportion."""
        error = np.linalg.norm(scene.residuals(self._tracks), axis=1)
        linear = self._huber_px * (error - 0.5 * self._huber_px)
        cost = np.where(error <= self._huber_px, 0.5 * error**2, linear).sum()
        known, difference = self._differences(scene)
        prior = np.log1p((difference[known] ** 2).sum(axis=1)).sum() + (self._lens_differences(scene) ** 2).sum()
        return float(cost + 0.5 * self._variance * prior)

    def lens_sigmas(self, scene: Scene) -> Array:
        """Return (G, 5) standard deviations of an adjusted scene's lenses: the larger of `lens_uncertainties`."""
        return np.asarray(np.maximum(*self.lens_uncertainties(scene)))

    def lens_uncertainties(self, scene: Scene) -> tuple[Array, Array]:
        """Return two (G, 5) standard deviations of an adjusted scene's lenses, by pictures and priors, in any frame.

        One for independent errors, whose variance the residuals show after the degrees of freedom that the fit took;
        one for errors that are the same within a picture, as an incomplete lens or a bent image makes them (a sandwich
        estimator with pictures as clusters [liang86]).
        """
        normal = self._normal(scene)
        V_inverse = _inverse(normal.V)
        S, WV = _reduced(normal, V_inverse)
        own = POSE * len(scene.centres)
        columns, free = self._lens_covariance(scene, S)
        residuals, F, E = self._weighted(scene)
        freedom = residuals.size / max(residuals.size - free - 3 * self._tracks.count, 1)
        variance = freedom * float((residuals**2).mean())
        independent = variance * np.diag(columns[own:])
        point = (WV.T @ columns).reshape(len(V_inverse), 3, -1)
        moved = (F @ columns).reshape(*residuals.shape, -1) - E @ point[self._tracks.point]
        by_picture = np.zeros((len(scene.centres), columns.shape[1]))
        np.add.at(by_picture, self._tracks.picture, np.einsum("mi,mik->mk", residuals, moved))
        stiff = self._variance / np.where(self._held, 1.0, self._priors.lens_sigmas.ravel()) ** 2
        prior = self._variance * (stiff[:, None] * columns[own:] ** 2)[~self._held].sum(axis=0)
        together = prior + freedom * (by_picture**2).sum(axis=0)
        return np.sqrt(independent).reshape(-1, PARAMETERS), np.sqrt(together).reshape(-1, PARAMETERS)

    @property
    def _held(self) -> NDArray[np.bool_]:
        """(5G,) which parameters of the lenses stay."""
        return np.asarray(self._priors.lens_sigmas.ravel() == 0.0)

    def _lens_covariance(self, scene: Scene, S: Array) -> tuple[Array, int]:
        """Return the lenses' columns of S^-1 over all cameras, zero for what is held; and the number of free rows."""
        own = POSE * len(scene.centres)
        far = int(np.argmax(np.linalg.norm(scene.centres - scene.centres[0], axis=1)))
        axis = int(np.argmax(np.abs(scene.centres[far] - scene.centres[0])))
        held = [*range(POSE), POSE * far + 3 + axis]  # a frame and a scale, on which the lenses do not depend
        held += (own + np.flatnonzero(self._held)).tolist()
        free = np.setdiff1d(np.flatnonzero(np.diag(S) > 0.0), held)
        scale = np.sqrt(np.diag(S)[free])
        values, vectors = np.linalg.eigh(S[np.ix_(free, free)] / np.outer(scale, scale))
        inverse = np.zeros_like(S)
        inverse[np.ix_(free, free)] = (vectors / np.maximum(values, TINY)) @ vectors.T / np.outer(scale, scale)
        return inverse[:, own:], len(free)

    def _differences(self, scene: Scene) -> tuple[NDArray[np.bool_], Array]:
        """Return which positions are known, and (N, 3) differences to them in sigmas."""
        difference = (scene.centres - self._priors.positions) / self._priors.position_sigmas
        return np.asarray(np.isfinite(difference).all(axis=1)), difference

    def _lens_differences(self, scene: Scene) -> Array:
        sigma = self._priors.lens_sigmas
        difference = (scene.lenses - self._priors.lenses) / np.where(sigma > 0.0, sigma, 1.0)
        return np.asarray(np.where(sigma > 0.0, difference, 0.0))

    def _normal(self, scene: Scene) -> _Normal:
        residuals, F, E = self._weighted(scene)
        r = residuals.ravel()
        V = np.add.reduceat(np.einsum("mki,mkj->mij", E, E), self._starts, axis=0)
        point_gradient = np.add.reduceat(np.einsum("mki,mk->mi", E, r.reshape(-1, 2)), self._starts, axis=0)
        mixed = csr_array(F.T @ _spread(E, self._tracks.point, self._tracks.count))
        U, gradient = csr_array(F.T @ F), F.T @ r
        diagonal, extra = self._prior_terms(scene)
        return _Normal(csr_array(U + _diagonal(diagonal)), V, mixed, gradient + extra, point_gradient)

    def _weighted(self, scene: Scene) -> tuple[Array, csr_array, Array]:
        """Return (M, 2) residuals and the Jacobians over cameras and points, with the roots of Huber's weights."""
        residuals = scene.residuals(self._tracks)
        error = np.linalg.norm(residuals, axis=1)
        root = np.sqrt(np.minimum(1.0, self._huber_px / np.maximum(error, TINY)))
        return root[:, None] * residuals, *self._jacobians(scene, root)

    def _jacobians(self, scene: Scene, root: Array) -> tuple[csr_array, Array]:
        """Return the weighted Jacobian over the cameras (2M, 6N + 5G) and (M, 2, 3) blocks over the points."""
        tracks, count = self._tracks, len(scene.centres)
        inside = scene.in_camera(tracks)
        lens_of = scene.lens_of[tracks.picture]
        by_cam, by_lens = project_jacobians(inside, scene.lenses[lens_of])
        by_point = by_cam @ scene.R_cam_map[tracks.picture]
        blocks = np.concatenate([by_cam @ -skew(inside), -by_point, by_lens], axis=2) * root[:, None, None]
        pose = POSE * tracks.picture[:, None] + np.arange(POSE)
        lens = POSE * count + PARAMETERS * lens_of[:, None] + np.arange(PARAMETERS)
        columns = np.repeat(np.concatenate([pose, lens], axis=1), 2, axis=0)
        width = POSE + PARAMETERS
        starts = np.arange(len(columns) + 1) * width
        shape = (len(columns), POSE * count + PARAMETERS * len(scene.lenses))
        return csr_array((blocks.ravel(), columns.ravel(), starts), shape=shape), by_point * root[:, None, None]

    def _prior_terms(self, scene: Scene) -> tuple[Array, Array]:
        """Return what the priors add to the diagonal and to the gradient of the cameras."""
        known, difference = self._differences(scene)
        difference = np.where(known[:, None], difference, 0.0)
        sigma = self._priors.position_sigmas
        weight = known[:, None] / (1.0 + (difference**2).sum(axis=1, keepdims=True))  # Cauchy's
        diagonal, gradient = np.zeros((len(known), POSE)), np.zeros((len(known), POSE))
        diagonal[:, 3:], gradient[:, 3:] = weight / sigma**2, weight * difference / sigma
        lens_sigma = self._priors.lens_sigmas
        safe = np.where(lens_sigma > 0.0, lens_sigma, 1.0)
        stiff, pull = np.where(lens_sigma > 0.0, safe**-2, HELD), self._lens_differences(scene) / safe
        everything = np.concatenate([diagonal.ravel(), stiff.ravel()]), np.concatenate([gradient.ravel(), pull.ravel()])
        return self._variance * everything[0], self._variance * everything[1]

    def _moved(self, scene: Scene, step: Array, point_step: Array) -> Scene:
        count = len(scene.centres)
        pose = step[: POSE * count].reshape(count, POSE)
        lens = step[POSE * count :].reshape(-1, PARAMETERS)
        return replace(
            scene,
            R_cam_map=so3_exp(pose[:, :3]) @ scene.R_cam_map,
            centres=scene.centres + pose[:, 3:],
            lenses=scene.lenses + np.where(self._priors.lens_sigmas > 0.0, lens, 0.0),
            points=scene.points + point_step,
        )


def _diagonal(values: Array) -> csr_array:
    count = len(values)
    return csr_array((values, np.arange(count), np.arange(count + 1)), shape=(count, count))


def _spread(blocks: Array, point: NDArray[np.intp], count: int) -> csr_array:
    """Return (M, 2, 3) blocks as a sparse (2M, 3P) matrix."""
    columns = np.repeat(3 * point[:, None] + np.arange(3), 2, axis=0)
    starts = np.arange(len(columns) + 1) * 3
    return csr_array((blocks.ravel(), columns.ravel(), starts), shape=(len(columns), 3 * count))


def _inverse(V: Array) -> Array:
    """Return the inverses of (P, 3, 3) blocks, a singular one of which is made just regular."""
    scale = np.trace(V, axis1=1, axis2=2)[:, None, None]
    return np.linalg.inv(V + (TINY + TINY * scale) * np.eye(3))


def _reduced(normal: _Normal, V_inverse: Array) -> tuple[Array, csr_array]:
    """Return the Schur complement of the points, U - W V^-1 W^T, and W V^-1."""
    count = len(V_inverse)
    blocks = bsr_array((V_inverse, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count))
    WV = csr_array(normal.W @ blocks)
    return np.asarray((normal.U - WV @ normal.W.T).toarray()), WV


def _step(normal: _Normal, damping: float) -> tuple[Array, Array]:
    """Return the damped step of the cameras and of the points."""
    own = np.einsum("pii->pi", normal.V)
    V_inverse = _inverse(normal.V + damping * own[:, :, None] * np.eye(3))
    S, WV = _reduced(normal, V_inverse)
    diagonal = normal.U.diagonal()
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))  # pictures without points stay
    S = S / np.outer(scale, scale) + np.diag(np.where(diagonal > 0.0, damping, 1.0))
    right = (WV @ normal.point_gradient.ravel() - normal.gradient) / scale
    try:
        step = scipy.linalg.cho_solve(scipy.linalg.cho_factor(S, lower=True), right) / scale
    except np.linalg.LinAlgError:
        return np.full(len(S), np.nan), np.zeros_like(normal.point_gradient)
    back = -normal.point_gradient - (normal.W.T @ step).reshape(-1, 3)
    return step, np.einsum("pij,pj->pi", V_inverse, back)
