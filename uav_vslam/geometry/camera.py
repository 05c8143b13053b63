# SPDX-License-Identifier: Apache-2.0
"""Pinhole camera with optical axes (x right, y down, z forward), behind a lens of one of three distortion models.

`plumb_bob`             radial and tangential: k1, k2, p1, p2, k3 ("radtan" of Kalibr, "radial-tangential" of EuRoC)
`rational_polynomial`   the same, its radial part over a second polynomial: k1, k2, p1, p2, k3, k4, k5, k6
`equidistant`           fisheye [kannala06]: k1 to k4 of the angle from the axis
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_vslam.errors import CalibrationError

Array = NDArray[np.float64]

COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}  # of each model, named as in CameraInfo
UNDISTORT_ITERATIONS = 20
UNDISTORTED_PX = 1e-3  # largest reprojection error of a converged solution
MAX_RAY = 10.0  # tangent of the largest angle from the axis that a pinhole can stand for, 84 degrees
MOST_MAGNIFIED = 100.0  # also where the distortion model folds over, and nothing is imaged
OPENCV_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Intrinsics of one camera, as `sensor_msgs/CameraInfo` holds them in K, D and distortion_model.

    Attributes:
        width, height: image size [px].
        fx, fy, cx, cy: focal lengths and principal point [px].
        distortion: (k,) coefficients of the model; all zero for an undistorted image, but not in `equidistant`.
        model: name of the distortion model.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    model: str = "plumb_bob"

    def __post_init__(self) -> None:
        if not (self.width > 0 and self.height > 0):
            raise CalibrationError(f"image size {self.width}x{self.height} is empty; is CameraInfo filled in?")
        if not (self.fx > 0 and self.fy > 0 and np.isfinite([self.fx, self.fy, self.cx, self.cy]).all()):
            raise CalibrationError(
                f"focal length ({self.fx}, {self.fy}) px must be positive; is CameraInfo.K filled in?"
            )
        if self.model not in COEFFICIENTS:
            raise CalibrationError(f"distortion model {self.model!r} is not supported; use {', '.join(COEFFICIENTS)}")
        count = COEFFICIENTS[self.model]
        if np.shape(self.distortion) != (count,) or not np.isfinite(self.distortion).all():
            raise CalibrationError(
                f"distortion {np.asarray(self.distortion).tolist()}: {self.model} needs {count} values; "
                "give those, or the name of the model that these are of"
            )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image [px]."""
        return self.width, self.height

    @property
    def centre(self) -> Array:
        """(2,) principal point [px]."""
        return np.array([self.cx, self.cy])

    @property
    def K(self) -> Array:
        """(3, 3) intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def magnified(self, share: float) -> Self:
        """Return the camera with focal lengths longer by a share of them."""
        return dataclasses.replace(self, fx=(1.0 + share) * self.fx, fy=(1.0 + share) * self.fy)

    def project(self, points_cam: ArrayLike) -> Array:
        """Project (..., 3) camera-frame points [m] to (..., 2) undistorted pixels; depth must not be zero."""
        p = np.asarray(points_cam, dtype=float)
        u = self.fx * p[..., 0] / p[..., 2] + self.cx
        v = self.fy * p[..., 1] / p[..., 2] + self.cy
        return np.stack([u, v], axis=-1)

    def project_jacobian(self, points_cam: ArrayLike) -> Array:
        """Return d(u, v)/d(point): (..., 2, 3) [px/m]."""
        p = np.asarray(points_cam, dtype=float)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        J = np.zeros((*p.shape[:-1], 2, 3))
        J[..., 0, 0] = self.fx / z
        J[..., 0, 2] = -self.fx * x / z**2
        J[..., 1, 1] = self.fy / z
        J[..., 1, 2] = -self.fy * y / z**2
        return J

    def bearings(self, pixels: ArrayLike) -> Array:
        """Return (..., 3) camera-frame rays with z = 1 through (..., 2) undistorted pixels."""
        uv = np.asarray(pixels, dtype=float)
        x = (uv[..., 0] - self.cx) / self.fx
        y = (uv[..., 1] - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def distort(self, pixels: ArrayLike) -> Array:
        """Map (..., 2) undistorted pixels to where the lens images them."""
        rays = self.bearings(pixels)
        x, y = rays[..., 0], rays[..., 1]
        r2 = x * x + y * y
        if self.model == "equidistant":
            scale = self._equidistant_scale(np.sqrt(r2))
            return np.stack([self.fx * x * scale + self.cx, self.fy * y * scale + self.cy], axis=-1)
        k1, k2, p1, p2, k3 = self.distortion[:5]
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if self.model == "rational_polynomial":
            k4, k5, k6 = self.distortion[5:]
            radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([self.fx * xd + self.cx, self.fy * yd + self.cy], axis=-1)

    def undistort(self, pixels: ArrayLike) -> Array:
        """Map (..., 2) raw pixels to the ideal pinhole's; a row is NaN where nothing is imaged there.

        `plumb_bob` by fixed-point iteration of `distort`, and Newton's method where that diverges, in the corners of
        wide lenses; the other models by OpenCV.
        """
        raw = np.asarray(pixels, dtype=float)
        if not self._distorts:
            return raw.copy()
        if self.model != "plumb_bob":
            return self._undistort_by_opencv(raw)
        ideal = raw.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(UNDISTORT_ITERATIONS):
                ideal = ideal + (raw - self.distort(ideal))
            lost = ~(np.abs(raw - self.distort(ideal)).max(axis=-1) <= UNDISTORTED_PX)
            if lost.any():
                ideal[lost] = self._undistort_by_newton(raw[lost])
        return ideal

    def magnification(self, pixels: ArrayLike) -> Array:
        """Return (...,) how many times larger errors of raw pixels are at (..., 2) undistorted ones.

        The root mean square over all directions: with J = d(raw)/d(undistorted), the Frobenius norm of J^-1 / sqrt(2).
        """
        ideal = np.asarray(pixels, dtype=float)
        if not self._distorts:
            return np.ones(ideal.shape[:-1])
        ends = self.distort(ideal[..., None, :] + [[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0], [0.0, -0.5]])
        (a, b), (c, d) = np.moveaxis(ends[..., :2, :] - ends[..., 2:, :], (-2, -1), (0, 1))
        norm, J_det = np.sqrt(0.5 * (a * a + b * b + c * c + d * d)), a * d - b * c
        imaged = (J_det * MOST_MAGNIFIED > norm) & (a + d > 0)
        return np.where(imaged, norm / np.where(imaged, J_det, 1.0), MOST_MAGNIFIED)

    @property
    def _distorts(self) -> bool:
        return self.model == "equidistant" or bool(np.any(self.distortion))

    def _equidistant_scale(self, radius: Array) -> Array:
        """Return by how much the lens shrinks rays (x, y, 1) at a radius = tan(theta)."""
        theta = np.arctan(radius)
        powers = theta[..., None] ** [2, 4, 6, 8]
        return np.asarray(theta * (1.0 + powers @ self.distortion) / np.maximum(radius, 1e-12) + (radius < 1e-12))

    def _undistort_by_opencv(self, raw: Array) -> Array:
        flat = np.ascontiguousarray(raw.reshape(-1, 1, 2))
        if len(flat) == 0:
            return raw.copy()
        if self.model == "equidistant":
            ideal = cv2.fisheye.undistortPoints(flat, self.K, self.distortion, P=self.K, criteria=OPENCV_CRITERIA)
        else:
            ideal = cv2.undistortPointsIter(flat, self.K, self.distortion, np.eye(3), self.K, OPENCV_CRITERIA)
        ideal = ideal.reshape(raw.shape)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = np.abs(raw - self.distort(ideal)).max(axis=-1) <= UNDISTORTED_PX
            found &= np.linalg.norm(self.bearings(ideal)[..., :2], axis=-1) <= MAX_RAY
        ideal[~found] = np.nan
        return ideal

    def _undistort_by_newton(self, raw: Array) -> Array:
        """Return (N, 2) undistorted pixels of raw ones; NaN where there is none or the distortion model folds over."""
        ideal = raw.copy()
        for _ in range(UNDISTORT_ITERATIONS):
            a, b, d = self._distortion_jacobian(ideal)
            u, v = np.moveaxis((raw - self.distort(ideal)) / [self.fx, self.fy], -1, 0)
            step = np.stack([d * u - b * v, a * v - b * u], axis=-1) / (a * d - b * b)[:, None]
            ideal = ideal + step * [self.fx, self.fy]
        a, b, d = self._distortion_jacobian(ideal)
        found = (np.abs(raw - self.distort(ideal)).max(axis=-1) <= UNDISTORTED_PX) & (a * d > b * b) & (a + d > 0)
        ideal[~found] = np.nan
        return ideal

    def _distortion_jacobian(self, pixels: Array) -> tuple[Array, Array, Array]:
        """Return d(xd)/dx, d(xd)/dy = d(yd)/dx and d(yd)/dy of `distort`, for focal lengths of one."""
        x, y, _ = np.moveaxis(self.bearings(pixels), -1, 0)
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))  # 2 d(radial)/d(r^2)
        a = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        d = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        return a, slope * x * y + 2.0 * (p1 * x + p2 * y), d
