# SPDX-License-Identifier: Apache-2.0
"""Camera images of the ground: rays on a coarse grid, interpolated in between, and one linear texture look-up.

A grid ray meets the height field z = h(x, y) by fixed-point steps, t <- (h(p(t)) - z_camera) / d_z, which shrink the
error by slope times tangent of the view angle each; four steps leave less than a millimetre.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.farm_texture import REACH_M
from uav_vslam.simulation.object_render import FLATTEST_RAY, SAMPLES, SolidPainter
from uav_vslam.simulation.rig import scaled
from uav_vslam.simulation.scenario import Purpose, SimulatedVehicle
from uav_vslam.simulation.shading import sunward
from uav_vslam.simulation.solids import Bounds
from uav_vslam.simulation.terrain import Ground, Relief, ground_of
from uav_vslam.types import StereoFrame

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

GRID_PX = 8
HEIGHT_STEPS = 4
BLUR_SAMPLES = 33
MEAN_GREY = np.float32(128.0)  # towards which reduced contrast fades
MOTION_STEP_S = 1e-3


def intersect(relief: Relief, origin: Array, rays: Array) -> Array:
    """Return (..., 3) points where rays from a (3,) `origin` meet the ground [m].

    Args:
        relief: the ground.
        origin: (3,) camera centre in the world [m].
        rays: (..., 3) directions in the world, of any length, pointing down.
    """
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    x0, y0 = origin[0], origin[1]
    height: NDArray[np.floating] = np.zeros(rays.shape[:-1])
    for _ in range(HEIGHT_STEPS):
        drop = height - origin[2]
        height = relief.height((x0 + drop * x).astype(np.float32), (y0 + drop * y).astype(np.float32))
    drop = height - origin[2]
    return np.stack([x0 + drop * x, y0 + drop * y, height.astype(float)], axis=-1)


def lean_bounds(origin: Array, points: Array) -> Bounds:
    """Return a rectangle [m] that contains all solids that rays can meet before the ground, and what shades these.

    Args:
        origin: (3,) where the rays begin [m].
        points: (..., 3) where they meet the ground [m].
    """
    share = REACH_M / np.maximum(origin[2] - points[..., 2:], REACH_M)
    above = points + share * (origin - points)
    xy = np.concatenate([points[..., :2].reshape(-1, 2), above[..., :2].reshape(-1, 2)])
    (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
    return sunward((float(west), float(south), float(east), float(north)), REACH_M)


class CameraRenderer:
    """Renders one camera's view of the ground."""

    def __init__(self, camera: PinholeCamera, ground: Ground, *, supersample: int = 1, colour: bool = False) -> None:
        """Prepare the grid of rays.

        Args:
            camera: intrinsics; lens distortion is rendered too.
            ground: relief and texture.
            supersample: images are rendered this many times larger and averaged down, against aliasing.
            colour: BGR instead of grey.

        Raises:
            ValueError: colour is asked for, and the ground has none.
        """
        if colour and ground.colours is None:
            raise ValueError("the ground has no colours to render")
        self._camera, self._supersample = camera, supersample
        self._drawn = scaled(camera, float(supersample))
        self._ground = ground
        self._texture = ground.colours if colour and ground.colours is not None else ground.texture
        self._rays_cam = self._drawn.bearings(self._drawn.undistort(_grid(*self._drawn.size)))

    def render(self, T_world_cam: Pose, *, blur: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float32]:
        """Return the (H, W) image without noise, in grey levels, or (H, W, 3) BGR.

        Args:
            T_world_cam: pose of the optical frame.
            blur: image motion during the exposure along u and v [px].
        """
        rays = self._rays_cam @ T_world_cam.R.T
        rays[..., 2] = np.minimum(rays[..., 2], FLATTEST_RAY)
        points = intersect(self._ground.relief, T_world_cam.t, rays)
        image = self._ground_image(points[..., :2] / self._texture.m_per_px)
        if self._ground.farm is not None:
            image = self._with_solids(image, T_world_cam, points)
        if self._supersample > 1:
            image = cv2.resize(image, self._camera.size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.filter2D(image, cv2.CV_32F, motion_kernel(*blur), borderType=cv2.BORDER_REFLECT_101))

    def _ground_image(self, texels: Array) -> NDArray[np.generic]:
        """Return the image of the ground alone from the texels that the grid's rays meet."""
        low = np.floor(texels.min(axis=(0, 1))).astype(int) - 1
        high = np.ceil(texels.max(axis=(0, 1))).astype(int) + 2
        window = self._texture.window(int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        map_x, map_y = (self._enlarge(texels[..., k] - low[k]) for k in range(2))
        return np.asarray(cv2.remap(window, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _with_solids(self, image: NDArray[np.generic], T_world_cam: Pose, points: Array) -> NDArray[np.float32]:
        """Return the image with what stands on the ground, whose points the grid's rays meet."""
        assert self._ground.farm is not None
        painter = SolidPainter(
            self._drawn,
            T_world_cam,
            self._ground.farm.solids(lean_bounds(T_world_cam.t, points)),
            samples=max(4, SAMPLES // self._supersample**2),
        )
        return painter.draw(image.astype(np.float32), T_world_cam.t[2] - self._enlarge(points[..., 2]))

    def image_motion(self, T_world_cam: Pose, T_world_cam_later: Pose) -> Array:
        """Return the (2,) image motion [px] of the ground at the image's centre between two poses."""
        centre = np.array([0.5 * self._camera.width, 0.5 * self._camera.height])
        ray = T_world_cam.R @ self._camera.bearings(centre)
        point = intersect(self._ground.relief, T_world_cam.t, ray)
        later = self._camera.project(T_world_cam_later.inverse().apply(point))
        return np.asarray(later - centre)

    def _enlarge(self, grid: Array) -> NDArray[np.float32]:
        """Interpolate grid values to every pixel of the rendered image."""
        rows, columns = grid.shape
        size = columns * GRID_PX, rows * GRID_PX
        fine = cv2.resize(grid.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(fine[GRID_PX : GRID_PX + self._drawn.height, GRID_PX : GRID_PX + self._drawn.width])


class RenderedFlight:
    """The images of one simulated flight, rendered on demand; frame k is the same in any order."""

    def __init__(self, vehicle: SimulatedVehicle, ground: Ground | None = None) -> None:
        """Prepare to render.

        Args:
            vehicle: the flight.
            ground: shared between vehicles to share the tiles; None makes the scenario's own.
        """
        self._vehicle = vehicle
        ground = ground or ground_of(vehicle.scenario)
        supersample = max(1, round(1.0 / vehicle.scenario.scale))
        colour = vehicle.scenario.colour
        self._left = CameraRenderer(vehicle.rig.left, ground, supersample=supersample, colour=colour)
        self._right = CameraRenderer(vehicle.true_rig(0).right, ground, supersample=supersample, colour=colour)
        self._right_shading = _shading(vehicle)

    def __len__(self) -> int:
        return len(self._vehicle.frame_stamps_ns)

    def __iter__(self) -> Iterator[StereoFrame]:
        for k in range(len(self)):
            yield self.frame(k)

    def frame(self, k: int) -> StereoFrame:
        """Render stereo pair `k`."""
        rig = self._vehicle.true_rig(k)
        left = self._expose(self._left, rig.T_body_left, k)
        right = self._expose(self._right, rig.T_body_right, k)
        if self._right_shading is not None:
            right = right * self._right_shading.reshape(*right.shape[:2], *(1,) * (right.ndim - 2))
        return StereoFrame(
            int(self._vehicle.frame_stamps_ns[k]),
            self._with_noise(left, k, Purpose.LEFT_IMAGE),
            self._with_noise(right, k, Purpose.RIGHT_IMAGE),
        )

    def _expose(self, renderer: CameraRenderer, T_body_cam: Pose, k: int) -> NDArray[np.float32]:
        t = float(self._vehicle.frame_times_s[k])
        truth, scenario = self._vehicle.truth, self._vehicle.scenario
        pose, later = truth.pose(t) @ T_body_cam, truth.pose(t + MOTION_STEP_S) @ T_body_cam
        motion = renderer.image_motion(pose, later)
        length = scenario.blur_px * scenario.scale
        blur_u, blur_v = motion * (length / max(float(np.linalg.norm(motion)), 1e-12))
        image = renderer.render(pose, blur=(blur_u, blur_v))
        return image if scenario.contrast == 1.0 else MEAN_GREY + np.float32(scenario.contrast) * (image - MEAN_GREY)

    def _with_noise(self, image: NDArray[np.float32], k: int, purpose: Purpose) -> Grey:
        scenario = self._vehicle.scenario
        seed = np.random.SeedSequence([scenario.seed, self._vehicle.index, int(purpose), k])
        noise = np.random.default_rng(seed).standard_normal(image.shape, dtype=np.float32)
        return np.asarray(cv2.addWeighted(image, 1.0, noise, scenario.noise_sigma, 0.0, dtype=cv2.CV_8U))


def motion_kernel(blur_u: float, blur_v: float) -> NDArray[np.float32]:
    """Return the kernel of a straight blur [px]: the mean of bilinear splats along it; [1 6 1]/8 for one pixel."""
    half = int(np.ceil(0.5 * max(abs(blur_u), abs(blur_v)))) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    offsets = np.arange(-half, half + 1)
    for s in (np.arange(BLUR_SAMPLES) + 0.5) / BLUR_SAMPLES - 0.5:
        u = np.maximum(0.0, 1.0 - np.abs(offsets - s * blur_u))
        v = np.maximum(0.0, 1.0 - np.abs(offsets - s * blur_v))
        kernel += np.outer(v, u)
    return (kernel / BLUR_SAMPLES).astype(np.float32)


def _grid(width: int, height: int) -> Array:
    """Return (rows, columns, 2) pixels in the middle of GRID_PX blocks, one block beyond the image on each side."""
    u = (np.arange(-(-width // GRID_PX) + 2) - 1.0) * GRID_PX + 0.5 * (GRID_PX - 1)
    v = (np.arange(-(-height // GRID_PX) + 2) - 1.0) * GRID_PX + 0.5 * (GRID_PX - 1)
    return np.stack(np.meshgrid(u, v), axis=-1)


def _shading(vehicle: SimulatedVehicle) -> NDArray[np.float32] | None:
    """Return the (H, W) brightness factor of the right camera, None if it is one everywhere."""
    scenario, camera = vehicle.scenario, vehicle.rig.right
    if scenario.right_gain == 1.0 and scenario.right_vignette == 0.0:
        return None
    x = np.linspace(-1.0, 1.0, camera.width, dtype=np.float32)
    y = np.linspace(-1.0, 1.0, camera.height, dtype=np.float32)[:, None]
    falloff = 1.0 - scenario.right_vignette * 0.5 * (x**2 + y**2)
    return np.asarray(scenario.right_gain * falloff, dtype=np.float32)
