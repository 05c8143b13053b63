# SPDX-License-Identifier: Apache-2.0
"""What tracks of points that are no landmarks say about the past poses in the state.

A track is the stereo pixels of one point at several past poses. The point is triangulated from all of them and then
eliminated: with H_x and H_f = Q_1 R the whitened Jacobians by the poses and by the point, a residual r splits into

    (I - Q_1 Q_1^T) (r - H_x e_x) = noise      about the poses alone: Eq. (18) to (24) of [mourikis07]
    Q_1^T (r - H_x e_x) - R e_f   = noise      about the point, if it becomes a landmark

Together they are all the information of the track.

Noise of a track: the tracked patch slides slowly over the ground (a random walk along the way of its image, which both
cameras share), the left pixel scatters about it, the right one about the left one, and by a constant from camera to
camera. Taken for white, these errors let long tracks count for far more than they know.

Points that are detected anew in each image, not tracked, have white errors, the same in both cameras.

A track that fills the window is used, and goes on. Its constant is the same in each use: with k times the standard
deviation in the k-th, all of them together count for little more than the first, as while a vehicle stands.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uav_vslam.estimation.belief import VehicleObservation
from uav_vslam.estimation.observation import MIN_DEPTH_M
from uav_vslam.estimation.past_poses import PastPoses
from uav_vslam.estimation.rig_errors import RigErrors
from uav_vslam.geometry.rotation import skew
from uav_vslam.geometry.stereo import StereoRig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_VIEWS = 2  # of a track: one stereo view of an unknown point says nothing about the pose
GAUSS_NEWTON_STEPS = 2

# Standard deviations in proportion to that of the right pixel about the left one.
LEFT = 0.7  # the left pixel about the patch
OFFSET = 0.36  # right pixel from left pixel, constant over a track
DRIFT = 0.05  # the patch over the ground, while its image moves by a pixel: the same at 7 and at 20 frames a second


@dataclass(frozen=True, slots=True)
class Tracks:
    """Stereo pixels of T tracks at V past poses, oldest first.

    Attributes:
        pixels: (T, V, 4) undistorted pixels; anything where not seen.
        seen: (T, V).
        earlier: how often each of the T tracks, or all, has been used before, by views that are not among these.
        detected: in each image anew.
    """

    pixels: Array
    seen: Mask
    earlier: NDArray[np.intp] | int = 0
    detected: bool = False

    def __len__(self) -> int:
        return len(self.seen)

    @property
    def way_px(self) -> Array:
        """(V,) how far the image has moved over the left camera since the first view, by the median track [px]."""
        if len(self) == 0:
            return np.zeros(self.seen.shape[1])
        both = self.seen[:, 1:] & self.seen[:, :-1]
        moved = np.linalg.norm(np.diff(self.pixels[:, :, :2], axis=1), axis=2)
        ascending, count = np.sort(np.where(both, moved, np.inf), axis=0), both.sum(axis=0)
        medians = np.take_along_axis(ascending, np.stack([(count - 1) // 2, count // 2]), axis=0).mean(axis=0)
        return np.concatenate([[0.0], np.cumsum(np.where(count > 0, medians, 0.0))])

    @property
    def newest_views(self) -> NDArray[np.intp]:
        """(T,) the view in which each was seen last."""
        return np.asarray(self.seen.shape[1] - 1 - np.argmax(self.seen[:, ::-1], axis=1))

    @property
    def newest_pixels(self) -> Array:
        """(T, 4) where each was seen last."""
        return np.asarray(self.pixels[np.arange(len(self)), self.newest_views])


@dataclass(frozen=True, slots=True)
class TrackObservation:
    """T tracks linearised at the past poses, whitened; rows of unseen views are zero.

    Attributes:
        points: (T, 3) their points, map frame [m].
        residual: (T, 4V) at the points.
        H: (T, 4V, rig errors + 6V) Jacobian by the rig's errors and the past poses.
        Q: (T, 4V, 3), R: (T, 3, 3) factors of the Jacobian by the point.
        views: (T,) how many.
        good: (T,) triangulated in front of the cameras.
    """

    points: Array
    residual: Array
    H: Array
    Q: Array
    R: Array
    views: NDArray[np.intp]
    good: Mask

    def chosen(self, rows: Mask) -> "TrackObservation":
        """Return some of the tracks."""
        parts = (getattr(self, each.name)[rows] for each in dataclasses.fields(self))
        return TrackObservation(*parts)

    @property
    def of_points(self) -> Array:
        """(T, 3, ...) Q_1^T H."""
        return np.asarray(np.swapaxes(self.Q, 1, 2) @ self.H)

    def joined(self, other: "TrackObservation") -> "TrackObservation":
        """Return these tracks and then others, seen at the same past poses."""
        parts = (np.concatenate([getattr(of, each.name) for of in (self, other)]) for each in dataclasses.fields(self))
        return TrackObservation(*parts)

    def gated(self, P: Array, probability: float, *, mean: Array | None = None) -> tuple[Mask, Array]:
        """Test each track against a mean, by default zero, and covariance P of errors of the rig and the past poses.

        Returns:
            (T,) which tracks pass a chi-square gate.
            (T,) variance that P adds to each track's residuals, all of them together, over that of one's noise.
        """
        G = self.of_points
        HP, GP = ((A.reshape(-1, len(P)) @ P).reshape(A.shape) for A in (self.H, G))
        added = np.einsum("tij,tij->t", HP, self.H) - np.einsum("tij,tij->t", GP, G)
        r, most = self._beside_points(mean), self._most(probability)
        nis = np.sum(r**2, axis=(1, 2))
        large = np.flatnonzero(~(nis <= most))  # P only makes them smaller
        Q = self.Q[large]
        S = (HP[large] - Q @ GP[large]) @ np.swapaxes(self.H[large] - Q @ G[large], 1, 2) + np.eye(r.shape[1])
        nis[large] = np.sum(r[large] * np.linalg.solve(S, r[large]), axis=(1, 2))
        return np.asarray(self.good & (nis <= most)), added

    def misfits(self, mean: Array, probability: float) -> Array:
        """Return (T,) squared residuals at a mean over the largest that pass the gate; infinite for those not good."""
        squares = np.sum(self._beside_points(mean) ** 2, axis=(1, 2))
        return np.where(self.good, squares / self._most(probability), np.inf)

    def _beside_points(self, mean: Array | None) -> Array:
        """Return (T, 4V, 1) the residuals at a mean, by default zero, that no place of a track's point explains."""
        r = (self.residual if mean is None else self.residual - self.H @ mean)[..., None]
        return r - self.Q @ (np.swapaxes(self.Q, 1, 2) @ r)

    def _most(self, probability: float) -> Array:
        """Return (T,) the largest squares of those that pass a chi-square gate."""
        return np.asarray(chdtri(4 * self.views - 3, 1.0 - probability))

    def of_poses(self) -> VehicleObservation:
        """Return what all tracks together say about the rig's errors and the past poses."""
        columns = self.H.shape[2]
        H, G = self.H.reshape(-1, columns), self.of_points.reshape(-1, columns)
        r, r_points = self.residual.ravel(), (np.swapaxes(self.Q, 1, 2) @ self.residual[..., None]).ravel()
        dof = int(np.sum(4 * self.views - 3))
        return VehicleObservation(H.T @ H - G.T @ G, H.T @ r - G.T @ r_points, float(r @ r - r_points @ r_points), dof)


def observe_tracks(
    tracks: Tracks, past: PastPoses, *, rig: StereoRig, errors: RigErrors, sigma_px: float
) -> TrackObservation:
    """Triangulate the tracks' points and linearise their views.

    Args:
        tracks: as seen at the past poses.
        past: V of them, at the exposures.
        rig: with its estimated errors.
        errors: layout of the rig's error states.
        sigma_px: standard deviation of a right pixel about the left one, or of each pixel coordinate if the points are
            detected anew [px].
    """
    views = _Views(tracks, past, rig, sigma_px)
    points = views.first_points()
    good = np.isfinite(points).all(axis=1)
    points[~good] = views.ahead
    for _ in range(GAUSS_NEWTON_STEPS):
        residual, J = (views.whitened(rows) for rows in views.linearise(points))
        J_T = np.swapaxes(J, 1, 2)
        normal = J_T @ J
        normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)  # no points have no views
        points = points + np.linalg.solve(normal, J_T @ residual)[..., 0]
    good &= views.in_front(points)
    points[~good] = views.ahead
    residual, J = views.linearise(points)
    by_pose = _by_pose(points, J, past)
    by_rig = _by_rig(views, points, by_pose, past, rig, errors)
    T, V, rows, columns = by_pose.shape
    H = np.empty((T, rows * V, errors.dim + columns * V))
    H[..., : errors.dim] = views.whitened(by_rig)
    views.whiten_blocks(by_pose, H[..., errors.dim :])
    Q, R = np.linalg.qr(views.whitened(J))
    return TrackObservation(points, views.whitened(residual)[..., 0], H, Q, R, tracks.seen.sum(axis=1), good)


class _Views:
    """The views of T tracks at V poses."""

    def __init__(self, tracks: Tracks, past: PastPoses, rig: StereoRig, sigma_px: float) -> None:
        self._tracks, self._rig = tracks, rig
        self._cameras = []
        for camera, T_body_camera in ((rig.left, rig.T_body_left), (rig.right, rig.T_body_right)):
            R_camera_map = np.swapaxes(past.R @ T_body_camera.R, 1, 2)
            centre = past.t + past.R @ T_body_camera.t
            self._cameras.append((camera, R_camera_map, -(R_camera_map @ centre[..., None])[..., 0]))
        raw_per_px = 1.0 / rig.magnification(tracks.pixels)[:, None, :]
        self._left_whitening, self._right_whitening = (W * raw_per_px for W in _whitening(tracks, sigma_px))
        self.ahead: Array = (past.pose(-1) @ rig.T_body_left).apply(np.array([0.0, 0.0, 1e3 * rig.baseline_m]))

    def first_points(self) -> Array:
        """Return (T, 3) points triangulated from each track's newest view; NaN where that fails."""
        newest, (_, R, t) = self._tracks.newest_views, self._cameras[0]
        points_left = self._rig.triangulate(self._tracks.newest_pixels, refinements=0)
        return np.asarray(np.einsum("tji,tj->ti", R[newest], points_left - t[newest]))

    def points(self, side: int, points: Array) -> Array:
        """Return (T, V, 3) points in the frame of the left (0) or right (1) camera; any where not seen."""
        _, R, t = self._cameras[side]
        inside = (points @ R.reshape(-1, 3).T).reshape(len(points), len(R), 3) + t
        return np.where(self._tracks.seen[..., None], inside, [0.0, 0.0, 1.0])

    def linearise(self, points: Array) -> tuple[Array, Array]:
        """Return residuals (T, V, 4, 1) and their Jacobian by the points (T, V, 4, 3); any where not seen."""
        residual = self._tracks.pixels.copy()
        J = np.empty((*residual.shape, 3))
        for side, (camera, R, _) in enumerate(self._cameras):
            p, of_side = self.points(side, points), slice(2 * side, 2 * side + 2)
            residual[..., of_side] -= camera.project(p)
            np.matmul(camera.project_jacobian(p), R, out=J[..., of_side, :])
        return residual[..., None], J

    def in_front(self, points: Array) -> Mask:
        """Return which points are in front of both cameras in all of their views."""
        depth = np.minimum(self.points(0, points)[..., 2], self.points(1, points)[..., 2])
        return np.asarray((depth > MIN_DEPTH_M).all(axis=1))

    def whitened(self, rows: Array) -> Array:
        """Return (T, 4V, k) with unit noise for (T, V, 4, k)."""
        T, V, _, k = rows.shape
        left = self._left_whitening @ rows[:, :, :2].reshape(T, V, 2 * k)
        right = self._right_whitening @ self._right(rows).reshape(T, V, 2 * k)
        return np.concatenate([left.reshape(T, 2 * V, k), right.reshape(T, 2 * V, k)], axis=1)

    def _right(self, rows: Array) -> Array:
        """Return of (A, B, 4, ...) rows those of the right pixel, whose errors are independent of the left one's."""
        right = rows[:, :, 2:]
        return right if self._tracks.detected else right - rows[:, :, :2]

    def whiten_blocks(self, blocks: Array, out: Array) -> None:
        """Put (T, V, 4, k), where each view depends on k columns of its own, into (T, 4V, kV) with unit noise."""
        T, V, _, k = blocks.shape
        by_view = blocks.transpose(0, 2, 1, 3)[:, None]
        left, right = by_view[:, :, :2], self._right(by_view)
        H = out.reshape(T, 2, V, 2, V, k, copy=False)
        np.multiply(self._left_whitening[:, :, None, :, None], left, out=H[:, 0])
        np.multiply(self._right_whitening[:, :, None, :, None], right, out=H[:, 1])


def _whitening(tracks: Tracks, sigma_px: float) -> tuple[Array, Array]:
    """Return (T, V, V) inverse factors of the covariance of the left pixels and of the right pixels minus them.

    They are zero where not seen. Of detected points, the second is that of the right pixels alone.
    """
    if tracks.detected:
        white = tracks.seen[:, None, :] * np.eye(tracks.seen.shape[1]) / sigma_px
        return white, white
    V, way_px = tracks.seen.shape[1], tracks.way_px
    earlier = np.broadcast_to(tracks.earlier, len(tracks))
    patterns = tracks.seen @ (1 << np.arange(V)) + (earlier << V)
    _, first, of_track = np.unique(patterns, return_index=True, return_inverse=True)
    masks = tracks.seen[first]
    both = masks[:, :, None] & masks[:, None, :]
    left = LEFT**2 * np.eye(V) + DRIFT**2 * np.minimum(way_px[:, None], way_px)
    right = np.eye(V) + (OFFSET * (1.0 + earlier[first, None, None])) ** 2
    factors = (np.linalg.cholesky(np.where(both, sigma_px**2 * C, np.eye(V))) for C in (left, right))
    own, match = ((np.linalg.inv(L) * both)[of_track] for L in factors)
    return np.asarray(own), np.asarray(match)


def _by_pose(points: Array, J: Array, past: PastPoses) -> Array:
    """Return (T, V, 4, 6): errors of a pose move the point by arm x xi - dp, relative to the cameras."""
    arms = points[:, None, :] - past.t
    return np.concatenate([-J, J @ skew(arms)], axis=-1)


def _by_rig(views: _Views, points: Array, by_pose: Array, past: PastPoses, rig: StereoRig, errors: RigErrors) -> Array:
    """Return (T, V, 4, rig errors)."""
    T, V = by_pose.shape[:2]
    if errors.dim == 0:
        return np.zeros((T, V, 4, 0))
    H = errors.pixel_jacobian(rig, views.points(0, points).reshape(-1, 3)).reshape(T, V, 4, errors.dim)
    if errors.has_time_offset:
        motion = np.hstack([past.v_map, past.rate_map])
        H[..., errors.time_offset.start - errors.rows.start] = np.einsum("tvki,vi->tvk", by_pose, motion)
    return H
