# SPDX-License-Identifier: Apache-2.0
"""The ground's height: an analytic field, so that ground truth, landmarks and images agree exactly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.scenario import FLEET, Purpose, Scenario
from uav_vslam.simulation.texture import Texture, texture_from

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
    """The ground as the cameras see it: a height field and its texture."""

    relief: Relief
    texture: Texture


def ground_of(scenario: Scenario) -> Ground:
    """Return the textured ground of a scenario, the same for all its vehicles.

    Raises:
        ConfigError: the scenario's texture can't be read.
    """
    seed = int(scenario.rng(FLEET, Purpose.TEXTURE).integers(2**31))
    texture = texture_from(scenario.texture, seed, image_m_per_px=scenario.texture_m_per_px)
    return Ground(relief_of(scenario), texture)
