# SPDX-License-Identifier: Apache-2.0
"""Image sets for the study of features: their pairs, and the truth where it is known."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.rig import kagaru_rig
from uav_vslam.simulation.scenario import SCENARIOS, Scenario, SimulatedVehicle, simulate_vehicle
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.engine.extracted_flights import ground_points, shown_at
from uav_vslam.vision.images import shrink

Pixels = NDArray[np.floating]
Image = NDArray[np.generic]
RENDERED_SPACINGS = (1, 2, 5, 10)
RENDERED_BAND = "rendered"


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One image: its set, band, number in the set, and its name and pixels; equal to itself alone."""

    group: str
    band: str
    number: int
    name: str
    image: Image


Truth = Callable[[View, View, Pixels], Pixels]  # two images and (N, 2) pixels in the first -> where in the second


@dataclass(frozen=True, slots=True)
class ImageSet:
    """Images of one place.

    Attributes:
        name: of the set.
        bands: images by number, the first being 0, by band.
        spacings, usual, cross: as in `datasets.image_sets.Layout`.
        truth: where every point is in any other image, of any band; None where it isn't known.
        still: the camera stood still.
    """

    name: str
    bands: dict[str, dict[int, View]]
    spacings: tuple[int, ...]
    usual: int = 1
    cross: int | None = None
    truth: Truth | None = None
    still: bool = False


@dataclass(frozen=True, slots=True)
class Pair:
    """Two images of a set to be matched."""

    images: ImageSet
    first: View
    second: View

    @property
    def label(self) -> str:
        """The set, both bands and both images."""
        band = self.first.band if self.first.band == self.second.band else f"{self.first.band} / {self.second.band}"
        return f"{self.first.group} {band} {self.first.name} – {self.second.name}"

    @property
    def spacing(self) -> int:
        """Difference of their numbers in the set."""
        return self.second.number - self.first.number

    def errors(self, first: Pixels, second: Pixels) -> Pixels | None:
        """Return the distances of (N, 2) second pixels from the true positions of the first [px]; None: not known."""
        if self.images.truth is None:
            return None
        true = self.images.truth(self.first, self.second, np.asarray(first, float))
        return np.asarray(np.linalg.norm(np.asarray(second) - true, axis=1))


def static_truth(shifts: Mapping[tuple[str, int], Pixels]) -> Truth:
    """Return the truth of a static camera, but for shifts.

    Args:
        shifts: by band and number, the (2,) shift [px] from an image to its set's common alignment.
    """

    def truth(first: View, second: View, pixels: Pixels) -> Pixels:
        return np.asarray(pixels + shifts[first.band, first.number] - shifts[second.band, second.number])

    return truth


def rendered_set(seed: int, width: int) -> ImageSet:
    """Return images `width` px wide of the left camera of a simulated flight, 2.8 m of flight apart."""
    scale = min(1.0, width / kagaru_rig().left.width)
    scenario = replace(SCENARIOS["kagaru"], seed=seed, vehicles=1, frames=max(RENDERED_SPACINGS) + 1, scale=scale)
    vehicle = simulate_vehicle(scenario, 0)
    flight, name = RenderedFlight(vehicle), f"flight {seed}"
    views = {k: View(name, RENDERED_BAND, k, str(k), flight.frame(k).left) for k in (0, *RENDERED_SPACINGS)}
    return ImageSet(name, {RENDERED_BAND: views}, RENDERED_SPACINGS, truth=flown(vehicle, scenario))


def flown(vehicle: SimulatedVehicle, scenario: Scenario) -> Truth:
    """Return the true positions of the left camera's pixels in later images of the flight."""
    relief, camera = ground_of(scenario).relief, vehicle.rig.left
    poses = [vehicle.truth.pose(float(t)) @ vehicle.rig.T_body_left for t in vehicle.frame_times_s]

    def truth(first: View, second: View, pixels: Pixels) -> Pixels:
        points_world = ground_points(relief, poses[first.number], camera, camera.undistort(pixels))
        return camera.distort(shown_at(poses[second.number], camera, points_world))

    return truth


def downscaled(image: Image, width: int) -> Image:
    """Return an image of at most the given width [px]."""
    return shrink(image, width / image.shape[1]) if image.shape[1] > width else image


def usual_pairs(images: ImageSet) -> Iterator[Pair]:
    """Yield each band's first image with the one at the usual distance, or the nearest that there is."""
    for views in images.bands.values():
        number = images.usual if images.usual in views else max(views)
        yield Pair(images, views[0], views[number])


def cross_pairs(images: ImageSet) -> Iterator[Pair]:
    """Yield the first image of each band with an image of every other band."""
    if images.cross is None:
        return
    for first in images.bands:
        for second in images.bands:
            if first != second:
                yield Pair(images, images.bands[first][0], images.bands[second][images.cross])


def spaced_pairs(images: ImageSet) -> Iterator[Pair]:
    """Yield each band's first image with those at all distances."""
    for views in images.bands.values():
        yield from (Pair(images, views[0], views[number]) for number in images.spacings if number in views)
