# SPDX-License-Identifier: Apache-2.0
"""Flies each recording of each flight, and compares with the conventional one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig, find_config, load_vehicle, replaced
from uav_vslam.config.settings import differences
from uav_vslam.datasets.bag import open_flight
from uav_vslam.datasets.flight_writer import write_flights
from uav_vslam.datasets.sensor_setup import with_noise_of_files
from uav_vslam.datasets.truth import trajectory_of
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.consistency import nees
from uav_vslam.evaluation.study import Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.recording import recording_of
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.simulation.terrain import ground_of
from uav_vslam.studies.engine.pool import in_pool, mean, ratio, rms
from uav_vslam.studies.engine.scores import nees_figures
from uav_vslam.studies.recordings.ways import PLAIN, WAYS, Made, Plain

VEHICLE = "uav1"
NOTES = {
    "Flights": "rendered at full size with their own noise; rgb8, mono16 and 16UC1 hold the grey levels of the plain "
    "recording, which the front end stretches where they have 16 bits",
    "Stamps": "of the right images alone are late; their exposures are those of the left ones",
    "IMU": "turned by 180 degrees about x, at (0.2, -0.1, 0.2) m, in a frame of its own that /tf_static connects; two "
    "successive readings average to the noise of a plain one",
    "Lens": "equidistant, k1 to k4 0.05, -0.02, 0.01, -0.003, rendered again: other pixels, so another noise; no "
    "camera_info and no /tf_static",
}


@dataclass(frozen=True, slots=True)
class Flown:
    """What one recording gave.

    Attributes:
        seed, way: which.
        ate_m: error over the flight [m].
        nees: (F,) of the position, over 3.
        frames, processed: number of frames.
        failure: why it can't be flown; empty if it was.
    """

    seed: int
    way: str
    ate_m: float
    nees: NDArray[np.float64]
    frames: int
    processed: int
    failure: str = ""


def study_rows(seeds: Sequence[int], *, frames: int, workers: int, on_flight: Callable[[], None]) -> list[Row]:
    """Return one row for each way.

    Args:
        seeds: of the flights.
        frames: of each flight.
        workers: processes, one a flight.
        on_flight: called when a flight has been flown in all ways.
    """
    flights = in_pool(_flown, [(seed, frames) for seed in seeds], workers, on_flight)
    runs = [run for of_flight in flights for run in of_flight]
    plain = {run.seed: run for run in runs if run.way == PLAIN}
    return [_row([run for run in runs if run.way == way], plain) for way in WAYS]


def _flown(job: tuple[int, int]) -> list[Flown]:
    """Render one flight, record it in every way and fly it."""
    seed, frames = job
    scenario = Scenario(seed=seed, vehicles=1, frames=frames)
    config = load_vehicle(find_config("kagaru"))
    runs = []
    with TemporaryDirectory() as scratch:
        plain = Plain(simulate_vehicle(scenario, 0), ground_of(scenario), Path(scratch) / "plain")
        write_flights(plain.bag, [recording_of(plain.vehicle, plain.ground)])
        for way, make in WAYS.items():
            with TemporaryDirectory(dir=scratch) as folder:
                runs.append(_fly(seed, way, make(plain, Path(folder)), config))
    return runs


def _fly(seed: int, way: str, made: Made, config: VehicleConfig) -> Flown:
    config = replaced(config, {f"input.{k}": v for k, v in differences(made.config).items()}, where=way)
    try:
        flight = open_flight(made.bag, VEHICLE, config.input)
        track = track_vehicle(flight, with_noise_of_files(config))
    except UavVslamError as error:
        return Flown(seed, way, float("nan"), np.zeros(0), 0, 0, str(error))
    recorded = flight.truth()
    estimate = Trajectory.from_estimates(track.poses)
    assert recorded is not None
    truth = trajectory_of(recorded)
    errors, consistency = absolute_error(estimate, truth), nees(estimate, truth)
    assert errors is not None
    assert consistency is not None
    return Flown(seed, way, errors.ate_m, consistency.position, track.frames_in, len(track.outputs))


def _row(runs: Sequence[Flown], plain: dict[int, Flown]) -> Row:
    good = [run for run in runs if not run.failure]
    ratios = [run.ate_m / plain[run.seed].ate_m for run in good]
    ate, reference = rms([run.ate_m for run in good]), rms([plain[run.seed].ate_m for run in good])
    return {
        "method": runs[0].way,
        "condition": "rendered leg, ADIS16480",
        "runs": len(runs),
        "failures": len(runs) - len(good),
        "failure": next((run.failure for run in runs if run.failure), ""),
        "processed_share": mean([run.processed / run.frames for run in good]),
        "ate_rms_m": ate,
        "ratio_to_plain": ratio(ate, reference),
        "ratio_to_plain_least": min(ratios, default=None),
        "ratio_to_plain_most": max(ratios, default=None),
        **nees_figures([(run.seed, run.nees) for run in good]),
    }
