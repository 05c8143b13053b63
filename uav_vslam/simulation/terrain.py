# SPDX-License-Identifier: Apache-2.0
"""The ground: its height, an analytic field, so that ground truth, landmarks and images agree exactly; its look."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.farm import Farm
from uav_vslam.simulation.farm_texture import GRASS, NEUTRAL, ColourTexture, FarmTexture, LitTexture, PlainTint, Tints
from uav_vslam.simulation.ridged import Ridged
from uav_vslam.simulation.scenario import FLEET, Purpose, Scenario
from uav_vslam.simulation.solids import Label
from uav_vslam.simulation.surface import picture, tops
from uav_vslam.simulation.texture import Texture, texture_from

Array = NDArray[np.float64]

COMPONENTS = 10
WAVELENGTHS_M = (40.0, 400.0)


class Relief:
    """Rolling farmland: a sum of plane waves of random direction, longer waves higher; zero on average."""

    def __init__(self, rms_m: float, rng: np.random.Generator) -> None:
        """Draw the waves.

        Args:
            rms_m: root mean square height [m]; 0 is flat ground.
            rng: draws wavelengths, directions and phases.
        """
        wavelength = np.geomspace(*WAVELENGTHS_M, COMPONENTS) * rng.uniform(0.85, 1.15, COMPONENTS)
        direction = rng.uniform(0.0, 2.0 * np.pi, COMPONENTS)
        wavenumber = 2.0 * np.pi / wavelength
        self._kx, self._ky = wavenumber * np.cos(direction), wavenumber * np.sin(direction)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, COMPONENTS)
        amplitude = wavelength / np.linalg.norm(wavelength)
        self._amplitude = rms_m * np.sqrt(2.0) * amplitude

    def height(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return heights [m] at world positions x, y [m] of equal shape, in their precision."""
        height = np.zeros_like(x)
        for kx, ky, phase, amplitude in zip(self._kx, self._ky, self._phase, self._amplitude, strict=True):
            height += x.dtype.type(amplitude) * np.sin(
                x.dtype.type(kx) * x + x.dtype.type(ky) * y + x.dtype.type(phase)
            )
        return height


def relief_of(scenario: Scenario) -> Relief:
    """Return the ground of a scenario, the same for all its vehicles."""
    return Relief(scenario.relief_m, scenario.rng(FLEET, Purpose.RELIEF))


@dataclass(frozen=True, slots=True)
class Ground:
    """The ground as the cameras see it, and what an ideal map of it would show.

    x, y are world positions [m], float64 arrays of equal shape.

    Attributes:
        relief: height of the bare ground.
        texture: its grey values, with the shadows of what stands on it.
        colours: the same in BGR; None for the grey values three times.
        farm: what stands on it; None for nothing.
    """

    relief: Relief
    texture: Texture
    colours: Texture | None = None
    farm: Farm | None = None

    def height(self, x: Array, y: Array) -> Array:
        """Return the height of the top surface [m], whatever stands there included; 2.5-D, without overhangs."""
        return tops(self.farm, self.relief.height, x, y).z

    def labels(self, x: Array, y: Array) -> NDArray[np.uint8]:
        """Return the `Label` of what is on top."""
        return tops(self.farm, self.relief.height, x, y).labels

    def grey(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Return grey levels seen from straight above, cast shadows included: an ideal orthophoto."""
        return picture(self.farm, self.relief.height, self.texture, x, y, colour=False)

    def colour(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Return (..., 3) BGR seen from straight above, cast shadows included; `grey` is its luminance (BT.601)."""
        if self.colours is None:
            return np.repeat(self.grey(x, y)[..., None], 3, axis=-1)
        return picture(self.farm, self.relief.height, self.colours, x, y, colour=True)

    def barns(self, west: float, south: float, east: float, north: float) -> Array:
        """Return the (N, 4, 2) footprints [m] of the barns that touch a rectangle, counter-clockwise."""
        solids = [] if self.farm is None else self.farm.solids((west, south, east, north))
        barns = [solid.footprint for solid in solids if isinstance(solid, Ridged) and solid.label == Label.BARN]
        return np.array(barns).reshape(-1, 4, 2)


def ground_of(scenario: Scenario) -> Ground:
    """Return the textured ground of a scenario, the same for all its vehicles.

    Raises:
        ConfigError: the scenario's texture can't be read.
    """
    relief, seed = relief_of(scenario), int(scenario.rng(FLEET, Purpose.TEXTURE).integers(2**31))
    if not scenario.objects:
        texture = texture_from(scenario.texture, seed, image_m_per_px=scenario.texture_m_per_px)
        return Ground(
            relief, texture, ColourTexture(texture, PlainTint(GRASS if scenario.texture == "grass" else NEUTRAL))
        )
    farm = Farm(int(scenario.rng(FLEET, Purpose.OBJECTS).integers(2**31)), relief.height)
    bare, tints = _farmland(scenario, farm.seed, seed)
    lit = LitTexture(bare, farm)
    return Ground(relief, lit, ColourTexture(lit, tints), farm)


def _farmland(scenario: Scenario, farm_seed: int, seed: int) -> tuple[Texture, Tints]:
    """Return the unshaded ground of a farm: its fields, or the scenario's pictures, which are grey."""
    if scenario.texture == "grass":
        fields = FarmTexture(farm_seed)
        return fields, fields
    return texture_from(scenario.texture, seed, image_m_per_px=scenario.texture_m_per_px), PlainTint(NEUTRAL)
