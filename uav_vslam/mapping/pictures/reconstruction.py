# SPDX-License-Identifier: Apache-2.0
"""From matched pairs to poses, surface and what there is to warn of."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import PictureError
from uav_vslam.mapping.pictures.agreement import agreeing, torn
from uav_vslam.mapping.pictures.densification import all_points
from uav_vslam.mapping.pictures.features import PictureFeatures
from uav_vslam.mapping.pictures.growth import seed_of
from uav_vslam.mapping.pictures.layout import lay_out
from uav_vslam.mapping.pictures.loops import without_contradicted
from uav_vslam.mapping.pictures.pairs import MatchedPair
from uav_vslam.mapping.pictures.picture import Picture
from uav_vslam.mapping.pictures.placement import FEWEST_POSITIONS, Placement, place
from uav_vslam.mapping.pictures.procedure import Adjusted, adjust, cameras_of
from uav_vslam.mapping.pictures.reading import listed
from uav_vslam.mapping.pictures.rigidity import loose_pictures
from uav_vslam.mapping.pictures.surface import PointSurface
from uav_vslam.mapping.pictures.tracks import join

UNCERTAIN_FOCAL = 0.02  # as a share: above it, heights are uncertain enough to tell


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """Poses and surface of a folder.

    Attributes:
        pictures: all of the folder, in the order of time.
        adjusted: poses, lenses and points in the map frame.
        placement: how that frame came about.
        surface: of the ground.
        pairs: number of pairs of pictures that were matched and agree.
        warnings: for the user.
    """

    pictures: tuple[Picture, ...]
    adjusted: Adjusted
    placement: Placement
    surface: PointSurface
    pairs: int
    warnings: tuple[str, ...]

    @property
    def height_m(self) -> float:
        """Median height of the cameras above the ground."""
        ground = float(np.median(self.adjusted.scene.points[:, 2]))
        return float(np.median(self.adjusted.scene.centres[self.adjusted.used, 2])) - ground

    @property
    def gsd_m(self) -> float:
        """Median size of a picture's pixel on the ground."""
        scene, used = self.adjusted.scene, self.adjusted.used
        return self.height_m / float(np.median(np.exp(scene.lenses[scene.lens_of[used], 0])))


def reconstruct(
    pictures: Sequence[Picture],
    features: Sequence[PictureFeatures],
    pairs: Sequence[MatchedPair],
    *,
    focal_known: bool = False,
    height_m: float | None = None,
) -> Reconstruction:
    """Return poses and surface of pictures.

    Args:
        pictures: all of a folder, in the order of time.
        features: of each.
        pairs: matched pairs.
        focal_known: focal lengths are given by the user and stay.
        height_m: the flight's median height above the ground, if the user knows it.

    Raises:
        PictureError: the pictures do not overlap enough.
    """
    if not pairs:
        raise PictureError(
            f"none of the {len(pictures)} pictures shows ground that another one shows; "
            "a mosaic needs neighbours that overlap by half or more, of ground with texture"
        )
    centre = [np.array([0.5 * (picture.width - 1), 0.5 * (picture.height - 1)]) for picture in pictures]
    centred = [each.pixels - middle for each, middle in zip(features, centre, strict=True)]
    sides = np.array([float(max(picture.width, picture.height)) for picture in pictures])
    pairs = without_contradicted(pairs, [each.pixels for each in features], sides)
    begun = seed_of(len(pictures), pairs)
    layout = lay_out(len(pictures), [pair for pair in pairs if {pair.first, pair.second} <= set(begun)], centred, sides)
    tracks = join(features, pairs)
    adjusted = adjust(pictures, layout, tracks, focal_known=focal_known)
    adjusted, placement = place(adjusted, pictures, height_m=height_m, focal_known=focal_known)
    surface = PointSurface(all_points(adjusted, tracks, pictures), picture_m=_picture_m(adjusted, sides))
    agree = agreeing(adjusted, pairs, features, pictures)
    warnings = (*_about_tears(pictures, torn(pairs, agree, adjusted.used)), *_warnings(pictures, adjusted, placement))
    return Reconstruction(tuple(pictures), adjusted, placement, surface, int(agree.sum()), warnings)


def _picture_m(adjusted: Adjusted, sides_px: NDArray[np.float64]) -> float:
    """Return the longest side on the ground of any picture used [m], for one that looks straight down."""
    scene, used = adjusted.scene, adjusted.used
    above_m = scene.centres[used, 2] - np.median(scene.points[:, 2])
    return float(np.max(above_m * sides_px[used] / np.exp(scene.lenses[scene.lens_of[used], 0])))


def _warnings(pictures: Sequence[Picture], adjusted: Adjusted, placement: Placement) -> Iterator[str]:
    missing = [picture.name for k, picture in enumerate(pictures) if k not in set(adjusted.used.tolist())]
    if missing:
        yield (
            f"{len(missing)} of {len(pictures)} pictures left out, too few of their points are found in the others "
            f"(blurred, too oblique, too little texture or overlap, or another place): {listed(missing)}"
        )
    loose = loose_pictures(adjusted.tracks)
    if len(loose):
        yield (
            f"the place and size of {len(loose)} pictures are uncertain: where they join the others, no ground is in "
            f"three pictures; more overlap along the path would tell: {listed([pictures[k].name for k in loose])}"
        )
    yield from _about_focal(pictures, adjusted)
    yield from _about_gps(pictures, placement)


def _about_tears(pictures: Sequence[Picture], apart: Sequence[MatchedPair]) -> Iterator[str]:
    if apart:
        names = sorted({pictures[picture].name for pair in apart for picture in (pair.first, pair.second)})
        yield (
            f"the mosaic is torn: {len(apart)} pairs of pictures that match well lie apart in it, of {listed(names)}; "
            "more overlap, in turns above all, would hold them together"
        )


def _about_focal(pictures: Sequence[Picture], adjusted: Adjusted) -> Iterator[str]:
    names, _ = cameras_of(pictures)
    for name, lens, sigma in zip(names, adjusted.scene.lenses, adjusted.lens_sigmas, strict=True):
        if sigma[0] > UNCERTAIN_FOCAL:
            yield (
                f"the focal length of {name}, {np.exp(lens[0]):.0f} px, is uncertain by {100 * sigma[0]:.0f} %: "
                "pictures that look straight down on flat ground fit any, at another height. The mosaic is hardly "
                "affected, heights are in proportion; give --focal-px if you know it"
            )


def _about_gps(pictures: Sequence[Picture], placement: Placement) -> Iterator[str]:
    if placement.unrelated:
        yield (
            "GPS contradicts the pictures as if its positions were those of others, and is not used; "
            "are they in the right order, and latitude and longitude not exchanged?"
        )
    if placement.scale == "none":
        missing = _missing_gps(pictures, placement)
        yield (
            f"{missing}, so the scale is arbitrary: one unit of the map is a hundredth of the flight's height; "
            "--height gives metres"
        )
    if placement.gps_m is None:
        return
    told = "scale, heading and position" if placement.scale == "gps" else "heading and position"
    if not placement.checked:
        yield (
            f"only {np.isfinite(placement.gps_m).sum()} different GPS positions: too few to check each other; "
            f"{told} come from a fit that is up to {np.nanmax(placement.gps_m):.0f} m off them, and may be far wrong"
        )
    elif not placement.believed:
        low, middle, high = np.nanpercentile(placement.gps_m, [10, 50, 90])
        given = " or the height given with --height" if placement.scale == "height" else ""
        yield (
            f"GPS contradicts the pictures{given}: after the best fit it is {middle:.0f} m off (median; "
            f"{low:.0f}–{high:.0f} m from 10 to 90 %); {told} come from that fit alone, and are as uncertain"
        )
    if placement.altitudes_off_m is not None:
        yield (
            f"GPS altitudes contradict the pictures, by {placement.altitudes_off_m:.0f} m (median), and are not used; "
            "the ground on average is made level, and the altitude of the map is uncertain"
        )
    if placement.altitudes_equal:
        yield (
            "GPS altitudes are equal in all pictures, so they are no measurement and not used; the ground on average "
            "is made level, and the altitude of the map is uncertain"
        )
    if placement.wrong:
        named = [f"{pictures[k].name} ({placement.gps_m[k]:.0f} m)" for k in placement.wrong]
        yield f"single GPS positions are wrong and have no influence: {listed(named)}"


def _missing_gps(pictures: Sequence[Picture], placement: Placement) -> str:
    """Return what is lacking of GPS to give the scale."""
    if placement.unrelated:
        return "no GPS positions that agree"
    given = any(picture.position is not None for picture in pictures)
    return f"fewer than {FEWEST_POSITIONS} different GPS positions" if given else "no GPS positions"
