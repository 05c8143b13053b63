# SPDX-License-Identifier: Apache-2.0
"""One recorded flight by several filters from many start states: does the result depend on the start?

Features depend neither on the filter nor on the start, so the images are searched once for all runs.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import StartConfig, VehicleConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.scores import track_scores
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.evaluation.trajectory_error import absolute_error
from uav_vslam.offline.track import track_vehicle
from uav_vslam.studies.engine.pool import grouped, in_pool, mean
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.studies.engine.score_columns import pooled_scores, values_of
from uav_vslam.studies.euroc.starts import Start, starts_of
from uav_vslam.types import NS_PER_S

NOTES = {
    "Starts": "recorded: the start state in the recording. drawn N: with an error drawn from its covariance by seed N. "
    "frame K: the true pose and velocity at that frame, unperturbed, with the biases of the recorded start and the "
    "variance of their walk since.",
    "ATE": "root mean square of the position errors, in the truth's frame, without alignment.",
    "frames_coasted": "frames after the first with no associated landmark, predicted by the INS alone.",
    "restarts": "re-initialisations after the back end detected that tracking was lost.",
    "NEES": "squared error over the filter's covariance, per axis, from the 21st frame of a run on: 1 is consistent.",
}


@dataclass(frozen=True, slots=True)
class Run:
    """One filter from one start.

    Attributes:
        method, start: names.
        track: poses at the frames, up to the filter's failure.
        associated: (F,) landmarks associated in each frame.
        restarts: how often the filter was re-initialised.
        failure: why it ended early; empty at the end of the flight.
    """

    method: str
    start: str
    track: Trajectory
    associated: NDArray[np.intp]
    restarts: int = 0
    failure: str = ""

    @property
    def lost(self) -> int:
        """Frames after the first without an associated landmark."""
        return int((self.associated[1:] == 0).sum())


def run_starts(
    flight: RecordedFlight,
    config: VehicleConfig,
    *,
    filters: Sequence[str],
    seeds: Sequence[int],
    workers: int = 1,
    on_run: Callable[[], None] = lambda: None,
) -> list[Run]:
    """Fly every filter from every start, a job each, and return the runs in this order."""
    starts = starts_of(flight, config.imu, seeds)
    jobs = [(flight, config, name, start) for name in filters for start in starts]
    return list(in_pool(run_start, jobs, workers, on_run))


def run_start(job: tuple[RecordedFlight, VehicleConfig, str, Start]) -> Run:
    """Fly one filter from one start; frames before it are dropped."""
    flight, config, method, start = job
    backend = dataclasses.replace(config.backend, filter=method)
    config = dataclasses.replace(config, backend=backend, start=StartConfig(method="given"))
    try:
        track = track_vehicle(dataclasses.replace(flight, initial_state=start.estimate), config)
    except (UavVslamError, np.linalg.LinAlgError) as error:
        return Run(method, start.name, Trajectory.from_estimates([]), np.zeros(0, np.intp), failure=str(error))
    reports = [output.report for output in track.outputs]
    poses = Trajectory.from_estimates([report.pose for report in reports])
    associated = np.array([report.associated for report in reports], np.intp)
    return Run(method, start.name, poses, associated, restarts=sum(bool(report.recovery) for report in reports))


def table_rows(flight: RecordedFlight, runs: Sequence[Run]) -> list[Row]:
    """Return the rows of `study.json`: the worst of each filter, then every run."""
    rows = [_row(flight, run) for run in runs]
    return [_worst(method, found) for method, found in grouped(rows, lambda row: str(row["method"])).items()] + rows


def _row(flight: RecordedFlight, run: Run) -> Row:
    error = absolute_error(run.track, flight.truth)
    return {
        TABLE: "Every run",
        "method": run.method,
        "condition": run.start,
        **pooled_scores([track_scores(run.track, flight.truth)]),
        "error_max_m": error.max_m if error else None,
        "frames_coasted": run.lost,
        "restarts": run.restarts,
        "frames": len(run.track),
        "failure": run.failure or None,
    }


def _worst(method: str, rows: list[Row]) -> Row:
    good = [row for row in rows if row["failure"] is None]
    return {
        TABLE: "Worst of all starts",
        "method": method,
        "condition": "all starts",
        "ate_worst_m": max(values_of(good, "ate_rms_m"), default=None),
        "ate_mean_m": mean(values_of(good, "ate_rms_m")),
        "frames_coasted_worst": max((row["frames_coasted"] for row in good), default=None),
        "nees_position": mean(values_of(good, "nees_position")),
        "nees_position_worst": max(values_of(good, "nees_position"), default=None),
        "nees_rotation": mean(values_of(good, "nees_rotation")),
        "nees_rotation_worst": max(values_of(good, "nees_rotation"), default=None),
        "restarts": sum(row["restarts"] for row in rows),
        "failures": len(rows) - len(good),
        "runs": len(rows),
    }


def error_series(flight: RecordedFlight, runs: Sequence[Run]) -> list[Row]:
    """Return each run's position error over the time since the recorded start, for plots."""
    series = []
    for run in runs:
        paired, truth = pair_with_truth(run.track, flight.truth)
        seconds = (paired.stamps_ns - flight.initial_state.state.stamp_ns) / NS_PER_S
        errors = np.linalg.norm(paired.positions - truth.positions, axis=1)
        series.append(
            {"method": run.method, "condition": run.start, "time_s": seconds.tolist(), "error_m": errors.tolist()}
        )
    return series
