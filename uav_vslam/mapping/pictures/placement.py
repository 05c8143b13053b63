# SPDX-License-Identifier: Apache-2.0
"""The frame of the result: z up from the ground, and east, north and metres as far as GPS tells them.

Pictures alone leave a similarity open. The plane through the ground's points, but those that are seen from one place
only, is made level. If GPS is there, scale, yaw and position follow from the similarity in the plane that brings half
of the positions nearest, whatever the others are (least median of squares [rousseeuw84], then re-weighted), and the
ground's slope from their heights. How far the positions then lie from the pictures' tells whether they can be believed;
if so, they enter a last adjustment.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import Datum
from uav_vslam.mapping.pictures.bundle import Priors, Scene
from uav_vslam.mapping.pictures.densification import ground_points
from uav_vslam.mapping.pictures.gps_positions import local_positions, without_repeats
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.procedure import Adjusted, finish, lens_priors
from uav_vslam.mapping.pictures.robust_fits import (
    FEWEST_CHECKED,
    REWEIGHTINGS,
    ground_plane,
    plane_similarity,
    rotation_to_up,
)
from uav_vslam.numerics import robust_sigma

Array = NDArray[np.float64]

HEIGHT_WITHOUT_SCALE = 100.0  # median height above the ground in units of the map, if nothing tells metres
FEWEST_POSITIONS = 3
BELIEVED_M = 6.0  # median distance up to which positions agree with the pictures: a plain receiver's worst
WRONG_M, WRONG_SIGMAS = 10.0, 4.0  # a single position farther off, and beyond so many sigmas, is reported
LEAST_SPREAD = 0.5  # of the fitted pictures to that of the positions; if less, they agree by chance only
LEAST_SIGMA_M = 0.1
VERTICAL_FACTOR = 1.5  # altitudes by GPS are worse than positions
LEVEL_SIGMA_RAD = 0.01  # positions that tell the level worse than this leave it to the ground
GROUND_SLOPE = 0.05  # standard deviation of the ground's slope on average, against which positions weigh
STEEPEST = 0.3  # slope that positions can make; if more, rather they drift
LEVELLINGS = 4  # each leaves the square of the slope


@dataclass(frozen=True, slots=True)
class Placement:
    """How the map's frame came about.

    Attributes:
        scale: "gps", "height" (given) or "none": one unit is then a hundredth of the flight's height.
        datum: of the map's origin; None without GPS.
        gps_m: (N,) distances in the plane between the pictures' and the GPS positions [m]; NaN without. None: no GPS.
        believed: GPS agrees with the pictures and took part in the adjustment; three positions are too few to tell.
        wrong: numbers of pictures whose single position is wrong.
        unrelated: there is GPS, but it is not used: its positions could as well be those of other pictures.
        altitudes_off_m: median distance of altitudes by GPS that contradict the pictures and are not used, although
            the positions in the plane are; None else.
        altitudes_equal: GPS gives all pictures one altitude, which is no measurement and not used.
    """

    scale: str
    datum: Datum | None
    gps_m: Array | None
    believed: bool
    wrong: tuple[int, ...]
    unrelated: bool = False
    altitudes_off_m: float | None = None
    altitudes_equal: bool = False

    @property
    def checked(self) -> bool:
        """There are enough positions by GPS to tell whether they agree with the pictures."""
        return self.gps_m is not None and int(np.isfinite(self.gps_m).sum()) >= FEWEST_CHECKED


def levelled(adjusted: Adjusted) -> Adjusted:
    """Return the scene with z up from the plane of its points, at a median height of one."""
    scene = adjusted.scene
    normal, point = ground_plane(ground_points(adjusted))
    centres = scene.centres[adjusted.used]
    if np.median((centres - point) @ normal) < 0.0:
        normal = -normal
    R = rotation_to_up(normal)
    moved = transformed(scene, 1.0, R, -R @ point)
    height = float(np.median(moved.centres[adjusted.used, 2]))
    return replace(adjusted, scene=transformed(moved, 1.0 / height, np.eye(3), np.zeros(3)))


def transformed(scene: Scene, scale: float, R: Array, t: Array) -> Scene:
    """Return the scene after x -> scale R x + t, with R (3, 3) and t (3,)."""
    return replace(
        scene,
        R_cam_map=scene.R_cam_map @ R.T,
        centres=scale * scene.centres @ R.T + t,
        points=scale * scene.points @ R.T + t,
    )


def place(
    adjusted: Adjusted, pictures: Sequence[Picture], *, height_m: float | None, focal_known: bool
) -> tuple[Adjusted, Placement]:
    """Give the result its frame, and let GPS take part if it agrees.

    Args:
        adjusted: the outcome by pictures alone.
        pictures: all of the folder.
        height_m: the flight's median height above the ground, given by the user; it takes precedence over GPS's scale.
        focal_known: focal lengths are given by the user.
    """
    flat = levelled(adjusted)
    recorded, datum = local_positions(pictures)
    positions = without_repeats(recorded)
    used = flat.used[np.isfinite(positions[flat.used]).all(axis=1)]
    if datum is None or len(used) < FEWEST_POSITIONS:
        return _without_gps(flat, height_m, unrelated=False)
    level, sloping = (_by_gps(one, positions, used, height_m) for one in (flat, _sloping(flat, positions, used)))
    altitudes_off_m = float(np.median(np.abs(sloping.scene.centres[used, 2] - positions[used, 2])))
    altitudes_agree = altitudes_off_m <= VERTICAL_FACTOR * BELIEVED_M
    altitudes_equal = len({position.height_m for k in used if (position := pictures[k].position)}) == 1
    altitudes_used = altitudes_agree and not altitudes_equal
    adjusted = sloping if altitudes_used else level
    checked = len(used) >= FEWEST_CHECKED
    believed = checked and float(np.median(_distances(adjusted, positions, used)[used])) <= BELIEVED_M
    if checked and not believed and _shrunken(flat, positions[used], used):
        return _without_gps(flat, height_m, unrelated=True)
    if not believed:
        adjusted = level
    distance = _distances(adjusted, positions, used)
    wrong: tuple[int, ...] = ()
    if believed and height_m is None:
        adjusted = _with_gps(
            adjusted, pictures, positions, distance[used], focal_known=focal_known, altitudes=altitudes_used
        )
        distance = _distances(adjusted, recorded, adjusted.used)
        bound = max(WRONG_M, WRONG_SIGMAS * robust_sigma(distance[used]))
        wrong = tuple(int(k) for k in adjusted.used if distance[k] > bound)
    ground = float(np.median(adjusted.scene.points[:, 2]))
    adjusted = replace(adjusted, scene=transformed(adjusted.scene, 1.0, np.eye(3), np.array([0.0, 0.0, -ground])))
    datum = replace(datum, altitude_m=datum.altitude_m + ground)
    return adjusted, Placement(
        "gps" if height_m is None else "height",
        datum,
        distance,
        believed,
        wrong,
        altitudes_off_m=altitudes_off_m if believed and not (altitudes_agree or altitudes_equal) else None,
        altitudes_equal=believed and altitudes_equal,
    )


def _without_gps(adjusted: Adjusted, height_m: float | None, *, unrelated: bool) -> tuple[Adjusted, Placement]:
    """Return the levelled scene in a size that is given, or arbitrary."""
    size = HEIGHT_WITHOUT_SCALE if height_m is None else height_m
    adjusted = replace(adjusted, scene=transformed(adjusted.scene, size, np.eye(3), np.zeros(3)))
    return adjusted, Placement("none" if height_m is None else "height", None, None, False, (), unrelated)


def _shrunken(adjusted: Adjusted, positions: Array, used: NDArray[np.intp]) -> bool:
    """Return whether the best fit makes the flight much smaller than the positions are spread, as chance does."""
    centres = adjusted.scene.centres[used, :2]
    turn, _ = plane_similarity(centres, positions[:, :2])
    spread, wanted = (np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)) for p in (centres, positions[:, :2]))
    return bool(abs(turn) * spread < LEAST_SPREAD * wanted)


def _by_gps(adjusted: Adjusted, positions: Array, used: NDArray[np.intp], height_m: float | None) -> Adjusted:
    """Return the levelled scene scaled, turned and shifted to the positions by a similarity alone."""
    centres = adjusted.scene.centres[used]
    turn, shift = plane_similarity(centres[:, :2], positions[used, :2])
    scale = abs(turn) if height_m is None else height_m
    c, s = turn.real / abs(turn), turn.imag / abs(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    t = np.median(positions[used] - scale * centres @ R.T, axis=0)
    if height_m is None:
        t[:2] = shift.real, shift.imag
    return replace(adjusted, scene=transformed(adjusted.scene, scale, R, t))


def _sloping(adjusted: Adjusted, positions: Array, used: NDArray[np.intp]) -> Adjusted:
    """Return the levelled scene turned so that the pictures rise as the positions do; level where these do not tell.

    The last adjustment could not do it: beside thousands of points, positions hardly resist a turn.
    """
    turned = adjusted
    for _ in range(LEVELLINGS):
        placed = _by_gps(turned, positions, used, None)
        sigma = _gps_sigma(_distances(placed, positions, used)[used])
        rise = _rise(placed.scene.centres[used], positions[used], sigma, _ground_slope(placed))
        up = np.array([-rise[0], -rise[1], 1.0])
        R = rotation_to_up(up / np.linalg.norm(up)).T
        turned = replace(placed, scene=transformed(placed.scene, 1.0, R, np.zeros(3)))
    if np.linalg.norm(_ground_slope(turned)) > STEEPEST:
        return adjusted
    height = float(np.median(turned.scene.centres[adjusted.used, 2]) - np.median(turned.scene.points[:, 2]))
    return replace(turned, scene=transformed(turned.scene, 1.0 / height, np.eye(3), np.zeros(3)))


def _ground_slope(adjusted: Adjusted) -> Array:
    """Return the (2,) gradient of the ground on average."""
    normal, _ = ground_plane(ground_points(adjusted))
    return np.asarray(-normal[:2] / normal[2])


def _rise(centres: Array, positions: Array, sigma_m: float, ground_slope: Array) -> Array:
    """Return the (2,) gradient to add to the centres' heights: to meet the positions', and for level ground."""
    plane, rise = centres[:, :2] - centres[:, :2].mean(axis=0), positions[:, 2] - centres[:, 2]
    resistance = VERTICAL_FACTOR * sigma_m / GROUND_SLOPE  # of level ground, beside positions of weight one
    weight = np.ones(len(rise))
    for _ in range(REWEIGHTINGS):
        A = np.vstack([weight[:, None] * np.column_stack([np.ones(len(rise)), plane]), resistance * np.eye(3)[1:]])
        x = np.linalg.lstsq(A, np.append(weight * rise, -resistance * ground_slope), rcond=None)[0]
        error = np.abs(rise - x[0] - plane @ x[1:])
        weight = 1.0 / np.sqrt(1.0 + (error / max(2.0 * float(np.median(error)), 1e-9)) ** 2)
    return np.asarray(x[1:])


def _gps_sigma(distances: Array) -> float:
    """Return the standard deviation of GPS along an axis that its distances show [m]."""
    return max(LEAST_SIGMA_M, float(np.median(distances)) / 1.1774)  # of a Rayleigh distribution


def _distances(adjusted: Adjusted, positions: Array, used: NDArray[np.intp]) -> Array:
    """Return (N,) distances in the plane, NaN for pictures not used."""
    distance = np.full(len(positions), np.nan)
    distance[used] = np.linalg.norm(adjusted.scene.centres[used, :2] - positions[used, :2], axis=1)
    return distance


def _with_gps(
    adjusted: Adjusted,
    pictures: Sequence[Picture],
    positions: Array,
    distance: Array,
    *,
    focal_known: bool,
    altitudes: bool,
) -> Adjusted:
    """Adjust again with GPS, whose standard deviation is what its distances show; its altitudes only if they agree."""
    sigma = _gps_sigma(distance)
    level_known = altitudes and _level_sigma(positions, sigma) <= LEVEL_SIGMA_RAD
    vertical = VERTICAL_FACTOR * sigma if level_known else 1e6
    lenses, lens_sigmas = lens_priors(pictures, known=focal_known)
    priors = Priors(lenses, lens_sigmas, positions, np.array([sigma, sigma, vertical]))
    side = float(np.median([max(picture.width, picture.height) for picture in pictures]))
    return finish(adjusted.scene, adjusted.tracks, priors, side)


def _level_sigma(positions: Array, sigma_m: float) -> float:
    """Return how well positions tell the level [rad]: a straight strip does not about its own direction."""
    plane = positions[np.isfinite(positions).all(axis=1), :2]
    across = float(np.linalg.svd(plane - plane.mean(axis=0), compute_uv=False)[-1])
    return VERTICAL_FACTOR * sigma_m / max(across, 1e-9)
