# SPDX-License-Identifier: Apache-2.0
"""Adjustment: from a dozen pictures laid out flat to all poses, lenses and points, without false matches.

The pictures of the layout start level, at the height that their scales mean. Rounds with ever tighter robust kernels
drop false observations. From there the scene grows picture by picture. The lenses are free from the start: a wrong one
would bend a long strip first, and the way back is long. A picture that does not fit in the end is placed anew by its
points (PnP), and left out if that fails.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.bundle import Bundle, Priors, Scene
from uav_vslam.mapping.pictures.growth import grown
from uav_vslam.mapping.pictures.layout import Layout
from uav_vslam.mapping.pictures.lens import PARAMETERS, TYPICAL_FOCAL
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.resection import FEWEST_POINTS, explained, resected
from uav_vslam.mapping.pictures.tracks import Tracks, strongest
from uav_vslam.numerics import robust_sigma

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

PER_PICTURE = 600  # points that each picture asks for
EXIF_SIGMA, UNKNOWN_SIGMA, DISTORTION_SIGMA = 0.05, 0.35, 0.1
PRINCIPAL_SIGMA = 3e-3  # of the principal point along an axis, as a share of the picture's longest side
ROUNDS = (1e-2, 4e-3, 1.5e-3)  # Huber's bound / side
FINAL_HUBER = 6e-4
LOST_SHARE = 4e-3  # median error / side of a picture that does not fit


@dataclass(frozen=True, slots=True)
class Adjusted:
    """The outcome, in a frame without a meaning yet.

    Attributes:
        scene: poses, lenses and points.
        tracks: observations kept, in pixels from the images' centres; numbers of pictures are the folder's.
        used: numbers of the pictures that have a pose, ascending.
        noise_px: robust standard deviation of the reprojection errors, per axis.
        lens_sigmas: (G, 5) of the lenses' parameters.
    """

    scene: Scene
    tracks: Tracks
    used: Rows
    noise_px: float
    lens_sigmas: Array


def cameras_of(pictures: Sequence[Picture]) -> tuple[list[str], Rows]:
    """Return the names of the cameras, and each picture's number among them."""
    names = sorted({picture.camera for picture in pictures})
    return names, np.array([names.index(picture.camera) for picture in pictures], np.intp)


def lens_priors(pictures: Sequence[Picture], *, known: bool) -> tuple[Array, Array]:
    """Return expected (G, 5) lens parameters, and their standard deviations.

    Args:
        pictures: all of them.
        known: the focal length is given by the user and stays; the rest of the lens is estimated as ever.
    """
    names, lens_of = cameras_of(pictures)
    expected, sigma = np.zeros((len(names), PARAMETERS)), np.full((len(names), PARAMETERS), DISTORTION_SIGMA)
    for g in range(len(names)):
        own = [picture for picture, lens in zip(pictures, lens_of, strict=True) if lens == g]
        focal = [picture.focal_px for picture in own if picture.focal_px is not None]
        side = max(own[0].width, own[0].height)
        expected[g, 0] = np.log(np.median(focal) if focal else TYPICAL_FOCAL * side)
        sigma[g, 0] = 0.0 if known else EXIF_SIGMA if focal else UNKNOWN_SIGMA
        sigma[g, 3:] = PRINCIPAL_SIGMA * side / np.exp(expected[g, 0])
    return expected, sigma


def centred(tracks: Tracks, pictures: Sequence[Picture]) -> Tracks:
    """Return tracks in pixels from the images' centres."""
    centre = np.array([[0.5 * (picture.width - 1), 0.5 * (picture.height - 1)] for picture in pictures])
    return replace(tracks, pixels=tracks.pixels - centre[tracks.picture])


def flat_scene(layout: Layout, tracks: Tracks, lenses: Array, lens_of: Rows) -> Scene:
    """Return the level scene of a layout: pictures look straight down on a plane at z = 0, one unit below the first."""
    turn = np.where(layout.turn == 0.0, 1.0, layout.turn)
    first = int(layout.used[0])
    unit = float(np.exp(lenses[lens_of[first], 0]))
    angle, height = np.angle(turn), np.abs(turn) * np.exp(lenses[lens_of, 0]) / unit
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(turn))
    # rows are the camera's axes in the map: the layout's y runs down, the map's up
    R_cam_map = np.stack([c, -s, zero, -s, -c, zero, zero, zero, zero - 1.0], axis=1).reshape(-1, 3, 3)
    centres = np.stack([layout.shift.real / unit, -layout.shift.imag / unit, height], axis=1)
    z = turn[tracks.picture] * (tracks.pixels @ np.array([1.0, 1j])) + layout.shift[tracks.picture]
    number = np.bincount(tracks.point, minlength=tracks.count)
    x, y = (np.bincount(tracks.point, part, tracks.count) / number / unit for part in (z.real, -z.imag))
    points = np.stack([x, y, np.zeros(tracks.count)], axis=1)
    return Scene(R_cam_map, centres, lenses.copy(), lens_of, points)


def adjust(pictures: Sequence[Picture], layout: Layout, tracks: Tracks, *, focal_known: bool) -> Adjusted:
    """Adjust everything.

    Args:
        pictures: all of the folder.
        layout: of those to begin with.
        tracks: all of them, in pixels.
        focal_known: focal lengths are given by the user.

    Raises:
        PictureError: too little is left.
    """
    sizes = [(picture.width, picture.height) for picture in pictures]
    side = float(np.median([max(size) for size in sizes]))
    everything = centred(tracks.chosen(strongest(tracks, len(pictures), PER_PICTURE, sizes)), pictures)
    expected, sigmas = lens_priors(pictures, known=focal_known)
    priors = no_positions(expected, sigmas, len(pictures))
    tracks = everything.chosen(np.isin(everything.picture, layout.used))
    scene = flat_scene(layout, tracks, expected, cameras_of(pictures)[1])
    scene, tracks = _in_rounds(scene, tracks, priors, sizes, ROUNDS)
    begun = np.unique(tracks.picture)
    if len(begun) < len(pictures):
        scene, tracks = grown(scene, everything, begun, priors, sizes)
        scene, tracks = _in_rounds(scene, tracks, priors, sizes, ROUNDS[-1:])
    return finish(scene, tracks, priors, side)


def _in_rounds(
    scene: Scene, tracks: Tracks, priors: Priors, sizes: Sequence[tuple[int, int]], shares: Sequence[float]
) -> tuple[Scene, Tracks]:
    """Adjust with ever tighter kernels, without false observations and lost pictures."""
    side = float(np.median([max(size) for size in sizes]))
    for share in shares:
        scene = Bundle(tracks, priors, huber_px=share * side).adjust(scene)
        scene, tracks = without_false(scene, tracks, share * side)
        scene, tracks = _without_lost(scene, tracks, sizes)
    return scene, tracks


def finish(scene: Scene, tracks: Tracks, priors: Priors, side_px: float) -> Adjusted:
    """Adjust once more with the tightest kernel, then with priors that weigh as the errors are correlated.

    Against thousands of points a prior counts for nothing, but where the points of a picture err together, as by a bent
    image, they tell as little of the lens as a few.
    """
    used = np.unique(tracks.picture)
    if len(used) < 2:
        raise PictureError("fewer than two pictures fit together; are they of one place, and do they overlap by half?")
    noise = robust_sigma(scene.residuals(tracks))
    bundle = Bundle(tracks, priors, huber_px=FINAL_HUBER * side_px, noise_px=noise)
    scene = bundle.adjust(scene)
    independent, together = bundle.lens_uncertainties(scene)
    sigmas = np.maximum(independent, together)
    grown = float(np.max(together / np.where(independent > 0.0, independent, np.inf)))
    if grown > 1.0:
        bundle = Bundle(tracks, priors, huber_px=FINAL_HUBER * side_px, noise_px=grown * noise)
        scene = bundle.adjust(scene)
        sigmas = bundle.lens_sigmas(scene)
    return Adjusted(scene, tracks, used, robust_sigma(scene.residuals(tracks)), sigmas)


def no_positions(lenses: Array, lens_sigmas: Array, count: int) -> Priors:
    """Return priors of the lenses alone."""
    return Priors(lenses, lens_sigmas, np.full((count, 3), np.nan), np.ones(3))


def without_false(scene: Scene, tracks: Tracks, most_px: float) -> tuple[Scene, Tracks]:
    """Drop observations that are off or behind their camera, and points that fewer than two pictures then see."""
    keep = explained(scene, tracks, most_px)
    return replace(scene, points=scene.points[tracks.of(keep)]), tracks.chosen(keep)


def _without_lost(scene: Scene, tracks: Tracks, sizes: Sequence[tuple[int, int]]) -> tuple[Scene, Tracks]:
    """Place pictures that do not fit anew by the points of the others; drop those for which that fails."""
    error = np.linalg.norm(scene.residuals(tracks), axis=1)
    keep = np.ones(len(error), bool)
    for picture in np.unique(tracks.picture).tolist():
        own = tracks.picture == picture
        if own.sum() >= FEWEST_POINTS and np.median(error[own]) <= LOST_SHARE * max(sizes[picture]):
            continue
        placed = resected(scene, tracks, picture, sizes[picture])
        if placed is None:
            keep[own] = False
        else:
            scene = placed
    return replace(scene, points=scene.points[tracks.of(keep)]), tracks.chosen(keep)
