# SPDX-License-Identifier: Apache-2.0
"""Stereo features without images, for Monte-Carlo studies: random points on the ground, seen by the true rig.

A landmark has one descriptor for the whole fleet; each view of it adds a little noise, so that the ratio test matches
views of one vehicle and of different ones.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import ConfigError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.scenario import FLEET, Purpose, Scenario, SimulatedVehicle
from uav_vslam.simulation.terrain import relief_of
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]

DESCRIPTOR_LENGTH = 128
PER_FRAME = 44.0  # landmarks in view of both cameras on average
LOOKALIKE_PX = (3.0, 15.0)  # offset of a look-alike, in image and disparity together
TWIN_M = (1.0, 6.0)  # distance of two landmarks with equal descriptors: not confused while well tracked
LEAST_DISPARITY = 0.5  # minimum share of the disparity that a look-alike keeps: its depth stays finite
ROW_STEPS = 3  # fixed-point steps from a point's row to the time when it is exposed, and back
REACH_PER_ALTITUDE = 2.0  # ground farther than this from the nadir is never in view


@dataclass(frozen=True, slots=True)
class LandmarkField:
    """Points on the ground that every vehicle of a scenario can see.

    Attributes:
        points_world: (N, 3) [m]; the row is the landmark's true identity.
        descriptors: (N, 128) uint8.
    """

    points_world: Array
    descriptors: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class LandmarkNoise:
    """Quality of the simulated front end.

    Attributes:
        sigma_px: standard deviation of each raw stereo pixel coordinate [px].
        descriptor_sigma: standard deviation of each descriptor entry between views.
        wrong_share: share of the features that carry another feature's descriptor.
        lookalike_share: share of the features moved to a similar point a few pixels away: such wrong matches pass a
            gate.
        missed_share: share of the landmarks in view that are not detected, drawn independently per frame.
        readout_s: of a rolling shutter whose middle row is exposed at the stamp, see `rig.readout_s`; 0: a global one.
    """

    sigma_px: float = 1.0
    descriptor_sigma: float = 6.0
    wrong_share: float = 0.0
    lookalike_share: float = 0.0
    missed_share: float = 0.0
    readout_s: float = 0.0


def scatter_landmarks(
    vehicles: list[SimulatedVehicle], *, per_frame: float = PER_FRAME, twin_share: float = 0.0
) -> LandmarkField:
    """Scatter landmarks over all ground that a fleet sees.

    Args:
        vehicles: the whole fleet of one scenario.
        per_frame: landmarks in view of both cameras on average, in level flight.
        twin_share: share of the landmarks with the same descriptor as another one a few metres away.

    Raises:
        ConfigError: the vehicles fly so low that no ground is in view of both cameras.
    """
    scenario = vehicles[0].scenario
    rng = scenario.rng(FLEET, Purpose.LANDMARKS)
    reach = REACH_PER_ALTITUDE * scenario.altitude
    tracks = np.concatenate([v.truth.position(v.frame_times_s)[:, :2] for v in vehicles])
    low, high = tracks.min(axis=0) - reach, tracks.max(axis=0) + reach
    count = round(per_frame / _footprint_m2(scenario, vehicles[0].rig) * float(np.prod(high - low)))
    xy = rng.uniform(low, high, (count, 2))
    descriptors = _draw_descriptors(count, rng)
    first = np.arange(round(0.5 * twin_share * count))
    second = first + count // 2
    angle, distance = rng.uniform(0.0, 2.0 * np.pi, len(first)), rng.uniform(*TWIN_M, len(first))
    xy[second] = xy[first] + distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    descriptors[second] = descriptors[first]
    return LandmarkField(np.column_stack([xy, relief_of(scenario).height(xy[:, 0], xy[:, 1])]), descriptors)


def observe(
    vehicle: SimulatedVehicle, landmarks: LandmarkField, *, noise: LandmarkNoise | None = None
) -> Iterator[tuple[StereoFeatures, NDArray[np.int64]]]:
    """Yield each frame's features and their true identities, -1 for a wrong match.

    Args:
        vehicle: the observer.
        landmarks: all landmarks.
        noise: quality of the features.
    """
    noise = noise or LandmarkNoise()
    rng = vehicle.scenario.rng(vehicle.index, Purpose.PIXELS)
    times = vehicle.frame_times_s
    positions, rotations = vehicle.truth.position(times), vehicle.truth.rotation(times)
    for frame, stamp_ns in enumerate(vehicle.frame_stamps_ns):
        near = _near(landmarks.points_world, positions[frame], REACH_PER_ALTITUDE * vehicle.scenario.altitude)
        points_body = (landmarks.points_world[near] - positions[frame]) @ rotations[frame]
        pixels, seen = _project(vehicle.true_rig(frame), points_body)
        if noise.readout_s:
            pixels = _exposed_by_rows(vehicle, frame, landmarks.points_world[near[seen]], pixels, noise.readout_s)
            inside = _inside(vehicle.rig, pixels)
            pixels, seen[seen] = pixels[inside], inside
        if noise.missed_share > 0:
            found = rng.random(len(pixels)) >= noise.missed_share
            pixels, seen[seen] = pixels[found], found
        magnified = vehicle.rig.magnification(pixels)[:, None]
        pixels = pixels + magnified * rng.normal(0.0, noise.sigma_px, pixels.shape)
        ids = near[seen]
        pixels, ids = _swap_pixels(pixels, ids, noise.wrong_share, rng)
        pixels, ids = _add_lookalikes(pixels, ids, noise.lookalike_share, vehicle.rig, rng)
        descriptors = _view(landmarks.descriptors[near[seen]], noise.descriptor_sigma, rng)
        yield StereoFeatures(int(stamp_ns), pixels.astype(np.float32), descriptors), ids


def _footprint_m2(scenario: Scenario, rig: StereoRig) -> float:
    """Return the ground area that both cameras see from level flight [m^2]."""
    camera = rig.left
    step = max(1, camera.width // 64)
    u, v = np.meshgrid(np.arange(0, camera.width, step), np.arange(0, camera.height, step))
    points = camera.bearings(np.stack([u.ravel(), v.ravel()], axis=-1)) * scenario.altitude
    both = _inside(rig, rig.project(points)).mean()
    if both == 0.0:
        raise ConfigError(f"no ground is in view of both cameras from {scenario.altitude:g} m; fly higher")
    return float(both * camera.width * camera.height * scenario.altitude**2 / (camera.fx * camera.fy))


def _draw_descriptors(count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw (N, 128) descriptors distributed like SIFT's: sparse, non-negative, of norm about 512."""
    raw = rng.gamma(0.6, 1.0, (count, DESCRIPTOR_LENGTH))
    raw *= 512.0 / np.linalg.norm(raw, axis=1, keepdims=True)
    return np.minimum(raw, 255.0).astype(np.uint8)


def _near(points: Array, position: Array, reach_m: float) -> NDArray[np.int64]:
    delta = np.abs(points[:, :2] - position[:2])
    return np.flatnonzero((delta[:, 0] < reach_m) & (delta[:, 1] < reach_m))


def _project(rig: StereoRig, points_body: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the (K, 4) pixels of the points that both cameras see, and the (N,) mask of those points."""
    points_left = rig.T_body_left.inverse().apply(points_body)
    in_front = (points_left[:, 2] > 0) & (rig.T_right_left.apply(points_left)[:, 2] > 0)
    pixels = rig.project(np.where(in_front[:, None], points_left, [0.0, 0.0, 1.0]))
    seen = in_front & _inside(rig, pixels)
    return pixels[seen], seen


def _exposed_by_rows(
    vehicle: SimulatedVehicle, frame: int, points_world: Array, pixels: Array, readout_s: float
) -> Array:
    """Return the (K, 4) pixels of points each at the time of its row, from those at the stamp."""
    rig, stamp_s = vehicle.true_rig(frame), vehicle.frame_times_s[frame]
    for _ in range(ROW_STEPS):
        parts = []
        for camera, columns in ((rig.left, slice(0, 2)), (rig.right, slice(2, 4))):
            times = stamp_s + readout_s * ((pixels[:, columns.stop - 1] + 0.5) / camera.height - 0.5)
            apart = points_world - vehicle.truth.position(times)
            points_body = np.einsum("nji,nj->ni", vehicle.truth.rotation(times), apart)
            parts.append(rig.project(rig.T_body_left.inverse().apply(points_body))[:, columns])
        pixels = np.hstack(parts)
    return pixels


def _inside(rig: StereoRig, pixels: Array) -> NDArray[np.bool_]:
    limit = np.array(rig.left.size * 2) - 1.0
    return np.asarray(np.all((pixels >= 0) & (pixels <= limit), axis=-1))


def _swap_pixels(
    pixels: Array, ids: NDArray[np.int64], share: float, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """Permute the pixels of a random share of the features among themselves; their identity becomes -1."""
    count = round(share * len(ids))
    if count < 2:
        return pixels, ids
    wrong = rng.choice(len(ids), count, replace=False)
    pixels, ids = pixels.copy(), ids.copy()
    pixels[wrong] = pixels[np.roll(wrong, 1)]
    ids[wrong] = -1
    return pixels, ids


def _add_lookalikes(
    pixels: Array, ids: NDArray[np.int64], share: float, rig: StereoRig, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """Move a random share of the features to a point nearby, in any direction of image and depth; their identity
    becomes -1. Those that would leave an image are not moved.
    """
    count = round(share * len(ids))
    if count == 0:
        return pixels, ids
    chosen = rng.choice(len(ids), count, replace=False)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    shift = direction * rng.uniform(*LOOKALIKE_PX, (count, 1))
    moved = pixels[chosen] + _parallel_shift(rig, pixels[chosen], shift)
    fits = _inside(rig, moved)
    pixels, ids = pixels.copy(), ids.copy()
    pixels[chosen[fits]] = moved[fits]
    ids[chosen[fits]] = -1
    return pixels, ids


def _parallel_shift(rig: StereoRig, pixels: Array, shift: Array) -> Array:
    """Return the (N, 4) change of stereo pixels when their points move by (N, 3) u, v and disparity [px]."""
    points = rig.triangulate(pixels)
    disparity = rig.left.fx * rig.baseline_m / points[:, 2]
    nearness = np.maximum(1.0 + shift[:, 2] / disparity, LEAST_DISPARITY)
    rays = points / points[:, 2:]
    rays[:, :2] += shift[:, :2] / [rig.left.fx, rig.left.fy]
    return rig.project(rays * (points[:, 2] / nearness)[:, None]) - rig.project(points)


def _view(descriptors: NDArray[np.uint8], sigma: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    noisy = descriptors + rng.normal(0.0, sigma, descriptors.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)
