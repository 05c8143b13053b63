# SPDX-License-Identifier: Apache-2.0
"""Makes docs/flight.png, the README's picture, from a simulated flight: `python docs/flight_figure.py` (minutes)."""

import dataclasses
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from uav_vslam.config import find_config, load_vehicle
from uav_vslam.evaluation.result import FlightResult
from uav_vslam.offline.flight import fly
from uav_vslam.offline.result import flight_result
from uav_vslam.report.style import STYLES, plain_log, tracks_of
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.studies.engine.flights import true_trajectory

SCENARIO = Scenario(seed=2, imu="consumer")


def simulate() -> FlightResult:
    """Fly, track and fuse."""
    vehicles = simulate_fleet(SCENARIO)
    config = dataclasses.replace(load_vehicle(find_config("kagaru")), imu=SCENARIO.imu_config)
    configs = {vehicle.name: config for vehicle in vehicles}
    tracks, fleet = fly([SimulatedSource(vehicle) for vehicle in vehicles], configs, workers=2)
    return flight_result("flight", tracks, fleet, {v.name: true_trajectory(v) for v in vehicles}, configs)


def draw(result: FlightResult, path: Path) -> None:
    """Draw plan view, error of each estimate, and what a camera saw."""
    figure, (plan, error, image) = plt.subplots(1, 3, figsize=(15, 4.2), width_ratios=[1.5, 1.1, 1.0])
    for name, vehicle in result.vehicles.items():
        first, truth = name == "uav1", vehicle.truth
        for kind, track in tracks_of(vehicle).items():
            look = STYLES[kind]
            style = {"color": look.colour, "lw": look.width, "zorder": look.order}
            label = look.label if first else None
            plan.plot(track.positions[:, 0], track.positions[:, 1], label=label, ls=look.dashes, **style)
            if kind != "truth" and truth is not None:
                seconds = (track.stamps_ns - track.stamps_ns[0]) / 1e9
                distance = ((track.positions - truth.positions) ** 2).sum(axis=1) ** 0.5
                error.plot(seconds, distance.clip(1e-2), ls="-" if first else ":", **style)
    plan.set(xlabel="East [m]", ylabel="North [m]", title="Two vehicles, plan view")
    plan.legend(loc="upper left", frameon=False, ncols=2)
    plain_log(error, "y")
    error.set(xlabel="Time [s]", ylabel="Position error [m]", title="Error: uav1 solid, uav2 dotted")
    error.grid(alpha=0.3, which="both")
    plan.grid(alpha=0.3)
    image.imshow(RenderedFlight(simulate_fleet(SCENARIO)[0]).frame(80).left, cmap="gray")
    image.set(title="uav1, front camera, 1280x960", xticks=[], yticks=[])
    figure.tight_layout()
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    draw(simulate(), Path(__file__).with_name("flight.png"))
