# SPDX-License-Identifier: Apache-2.0
"""The cooperative simulation of section 7.3.2 of [thesis], with its three communication modes (7.4.2).

Two vehicles in formation, 360 steps, process noise of sigma_w = 0.5 and pixel noise of 6 and of 10 px. The thesis does
not state what sigma_w multiplies, nor its height and speed: half of its noise scale w1, and the height and speed of
the filter study, are our interpretation.
"""

import dataclasses

from uav_vslam.config import VehicleConfig
from uav_vslam.evaluation.result import FlightResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.offline.flight import fly
from uav_vslam.offline.result import flight_result
from uav_vslam.simulation.landmarks import LandmarkNoise, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.cooperation import Setting
from uav_vslam.studies.engine.flights import RELIEF_PER_ALTITUDE, true_trajectory, with_backend
from uav_vslam.studies.engine.fusion_parts import Part

SIGMAS_PX = (6.0, 10.0)
SIGMA_W = "thesis_half"
ALTITUDE_M, SPEED, SPACING_M = 20.0, 6.0, 5.0

NOTES = {
    "Flights": "landmark level, two vehicles in formation, "
    f"{' and '.join(f'{sigma:g}' for sigma in SIGMAS_PX)} px, {ALTITUDE_M:g} m above ground at {SPEED:g} m/s",
    "Noise": "sigma_w = 0.5 is taken as half of w1 of section 4.7.1; pixel noise is simulated and assumed",
    "Settings": "wideband and narrowband as this software has them, none is S-SLAM; CI per landmark, written back, is "
    "how the thesis fused. In its wideband mode updated information is sent back to peers, in narrowband it is not",
}


def modes(steps: int) -> list[Part]:
    """Return a table for each pixel noise, a line for each communication mode."""
    settings = (
        Setting("wideband", {"feedback": True}),
        Setting("narrowband", {"mode": "narrowband"}),
        Setting("none", {"mode": "none"}),
        Setting("CI per landmark, written back, wideband", write_back="landmark_ci"),
        Setting("CI per landmark, written back, narrowband", write_back="landmark_ci_own"),
    )
    return [
        Part(f"{sigma:g} px", _scenario(steps), settings, _config(sigma), LandmarkNoise(sigma_px=sigma))
        for sigma in SIGMAS_PX
    ]


def example(part: Part, seed: int) -> FlightResult:
    """Fly one seed of a table in wideband, for the figures."""
    scenario = dataclasses.replace(part.scenario, seed=seed)
    vehicles = simulate_fleet(scenario)
    landmarks = scatter_landmarks(vehicles)
    fusion = dataclasses.replace(part.config.fusion, **part.settings[0].fusion)
    config = dataclasses.replace(part.config, imu=scenario.imu_config, fusion=fusion)
    configs = {vehicle.name: config for vehicle in vehicles}
    tracks, fleet = fly([SimulatedSource(vehicle, landmarks, part.noise) for vehicle in vehicles], configs)
    truths: dict[str, Trajectory | None] = {vehicle.name: true_trajectory(vehicle) for vehicle in vehicles}
    return flight_result(f"thesis {part.table}", tracks, fleet, truths, configs, seed=seed)


def _scenario(steps: int) -> Scenario:
    relief_m = RELIEF_PER_ALTITUDE * ALTITUDE_M
    return Scenario(frames=steps, altitude=ALTITUDE_M, speed=SPEED, relief_m=relief_m, spacing_m=SPACING_M, imu=SIGMA_W)


def _config(sigma_px: float) -> VehicleConfig:
    """There are no wrong matches here, so PnP is not needed, and with such noise its pose is worse."""
    return with_backend(
        VehicleConfig(), sigma_px=sigma_px, pnp_px=4.0 * sigma_px, pnp_beyond_px=1e6, redetection_px=0.0
    )
