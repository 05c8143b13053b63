# SPDX-License-Identifier: Apache-2.0
"""Every method of data association on the same images: chapter 6 of [thesis].

A landmark's true point is that of its first feature, however the filter has moved its estimate since.
"""

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association import ASSOCIATORS, Associator, InView
from uav_vslam.config import BackendConfig, VehicleConfig, find_config, load_vehicle
from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.geometry.pose import Pose
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.slam.backend import SlamBackend
from uav_vslam.slam.frame_report import FrameReport
from uav_vslam.slam.map_matching import MapMatcher
from uav_vslam.studies.association.image_matching import MatcherScore, kept_frames, score_matchers
from uav_vslam.studies.engine.association_stages import Score
from uav_vslam.studies.engine.extracted_flights import ExtractedFlight, recorded_flight, rendered_flight, shown_at
from uav_vslam.studies.engine.own_only import INS, Run, Track, feed
from uav_vslam.studies.engine.pool import grouped, median
from uav_vslam.studies.engine.recorded_flights import extracted_recording
from uav_vslam.studies.engine.score_columns import SCORES
from uav_vslam.studies.engine.scores import pooled
from uav_vslam.studies.engine.study import Progress
from uav_vslam.types import StereoFeatures

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]

CONDITIONS = {
    "clear": Scenario(vehicles=1),
    "low contrast, blurred": Scenario(vehicles=1, contrast=0.2, blur_px=4.0),
}
INITIAL_PX = 2.0  # a new landmark projects that close to its first feature
IN_MAP = "Association with the map"

NOTES = {
    "Flights": "one vehicle over rendered ground, ADIS16480; low contrast: a fifth of it, at the same noise, and "
    "4 px of motion blur. All associators have the same features, by SIFT at half resolution",
    "Pairs": "the associator's output before any other check. Right: the feature is within 4 px of where "
    "the true point of the landmark's first feature is (8 px in a recording, where only stereo gives the points). "
    "Recall: of the landmarks in view that some feature shows",
    "Errors": "of the whole back end, which first uses the associator's matches, and what PnP, consensus or a search "
    "of the whole map leaves of them where the innovations contradict them",
    "Time": "of this process, median over the frames; ms_association is the associator's share",
}


@dataclass(frozen=True, slots=True)
class Job:
    """One seed under a condition, by the associators named."""

    condition: str
    seed: int
    frames: int
    names: tuple[str, ...]


def study_rendered(job: Job) -> tuple[list["Association"], list[MatcherScore]]:
    """Fly a job with all associators, and try all matchers on its images."""
    scenario = dataclasses.replace(CONDITIONS[job.condition], seed=job.seed, frames=job.frames)
    flight = rendered_flight(job.condition, scenario, VehicleConfig(), keep=kept_frames(scenario.frames))
    return associate_all(flight, job.names), score_matchers(flight, ratio=flight.config.frontend.ratio)


def study_recording(
    recording: Path, config_name: str, methods: Sequence[str], progress: Progress
) -> list["Association"]:
    """Associate on a recording with truth; tracks would associate by themselves."""
    config = load_vehicle(find_config(config_name), overrides={"frontend.method": "sift"})
    found = extracted_recording(recording, None, config, progress)
    return associate_all(recorded_flight(recording.parent.name or "recording", found, config), methods)


@dataclass(frozen=True, slots=True)
class Found:
    """An associator's result in a frame: rows of the map, the features given to it, and its pairs."""

    rows: NDArray[np.intp]
    seen: StereoFeatures
    pairs: Pairs
    ms: float


class Recorder:
    """Records the matches of another associator."""

    def __init__(self, associate: Associator) -> None:
        self._associate = associate
        self.found: list[Found] = []

    def __call__(self, in_view: InView, seen: StereoFeatures, config: BackendConfig) -> Pairs:
        """Associate as the other one does, and record it."""
        started_ns = time.process_time_ns()
        pairs = self._associate(in_view, seen, config)
        self.found.append(Found(in_view.rows, seen, pairs, 1e-6 * (time.process_time_ns() - started_ns)))
        return pairs


class TruePoints:
    """The true points of a back end's landmarks, by identifier."""

    def __init__(self, flight: ExtractedFlight) -> None:
        self._flight = flight
        self._points: dict[int, Array] = {}

    def of(self, ids: NDArray[np.uint32]) -> Array:
        """Return (N, 3) points in the world [m]; NaN for a landmark whose first feature is not known."""
        unknown = np.full(3, np.nan)
        return np.array([self._points.get(k, unknown) for k in ids.tolist()]).reshape(-1, 3)

    def note(self, frame: int, ids: NDArray[np.uint32], landmarks: Array, T_map_body: Pose) -> None:
        """Remember the first feature of each landmark that this frame added.

        Args:
            frame: its number.
            ids, landmarks: (N,), (N, 3) all landmarks after this frame.
            T_map_body: pose from which new ones were initialised.
        """
        new = np.flatnonzero([k not in self._points for k in ids.tolist()])
        features = self._flight.steps[frame][0]
        if len(new) == 0 or len(features) == 0:
            return
        pixels = shown_at(T_map_body @ self._flight.rig.T_body_left, self._flight.rig.left, landmarks[new])
        distance = np.linalg.norm(pixels[:, None] - features.pixels[:, :2], axis=2)
        nearest = distance.argmin(axis=1)
        for row, feature, off in zip(new, nearest, distance[np.arange(len(new)), nearest], strict=True):
            self._points[int(ids[row])] = (
                self._flight.points[frame][feature] if off <= INITIAL_PX else np.full(3, np.nan)
            )


def score_pairs(found: Found, points: Array, T_world_left: Pose, flight: ExtractedFlight) -> Score:
    """Count an associator's pairs.

    Args:
        found: what it found.
        points: (L, 3) true points of all landmarks of the map [m].
        T_world_left: true pose of the left camera.
        flight: calibration and tolerance.
    """
    shown = shown_at(T_world_left, flight.rig.left, points[found.rows])
    known = np.asarray(np.isfinite(shown).all(axis=1))
    off_px = np.linalg.norm(shown[:, None] - found.seen.pixels[:, :2], axis=2)
    right = np.asarray(off_px <= flight.tolerance_px)  # NaN is not
    pairs = found.pairs[known[found.pairs[:, 0]]]
    good = int(right[pairs[:, 0], pairs[:, 1]].sum())
    return Score(len(pairs), good, good, int(right.any(axis=1).sum()))


@dataclass(frozen=True, slots=True)
class Association:
    """One associator on one flight: the run, its pairs, and its time in each frame [ms]."""

    run: Run
    score: Score
    ms: tuple[float, ...]


def associate_all(flight: ExtractedFlight, names: Sequence[str]) -> list[Association]:
    """Fly by the INS alone and with each associator."""
    ins = Run(INS, flight.condition, flight.seed, "uav1", Track(flight.ins), flight.truth, flight.ins)
    return [Association(ins, Score(), ()), *(fly(flight, name) for name in names)]


def fly(flight: ExtractedFlight, name: str) -> Association:
    """Feed a flight to the back end with one associator."""
    backend_config = dataclasses.replace(flight.config.backend, association=name)
    synchronised = dataclasses.replace(flight.config.rig, time_offset_sigma_s=0.0)  # no frame's landmarks wait
    config = dataclasses.replace(flight.config, backend=backend_config, rig=synchronised)
    recorder, truth = Recorder(ASSOCIATORS[name]), TruePoints(flight)
    matcher = MapMatcher(backend_config, recorder)
    backend = SlamBackend(flight.initial, rig=flight.rig, config=config, vehicle="uav1", matcher=matcher)
    scores, ms = [], []
    points = [truth.of(backend.landmarks[0])]  # of the map before each frame

    def score_frame(report: FrameReport) -> None:
        frame = len(points) - 1
        for found in recorder.found:
            scores.append(score_pairs(found, points[frame], flight.T_world_left[frame], flight))
            ms.append(found.ms)
        recorder.found.clear()
        truth.note(frame, *backend.landmarks, report.pose.T_map_body)
        points.append(truth.of(backend.landmarks[0]))

    track = feed(backend, flight.steps, score_frame)
    run = Run(name, flight.condition, flight.seed, "uav1", track, flight.truth, flight.ins)
    return Association(run, sum(scores, Score()), tuple(ms))


def map_rows(found: Sequence[Association]) -> list[Row]:
    """Return a row per condition and associator."""
    rows = []
    for (condition, name), chosen in grouped(found, lambda a: (a.run.condition, a.run.name)).items():
        score = sum((a.score for a in chosen), Score())
        frames = sum(len(a.run.truth) for a in chosen)
        figures = pooled([a.run for a in chosen])
        rows.append(
            {
                TABLE: IN_MAP,
                "method": name,
                "condition": condition,
                "pairs_per_frame": None if name == INS else score.left / frames,
                **score.row(),
                **{key: figures[key] for key in (*SCORES, "failures", "runs")},
                "ms_association": median([ms for a in chosen for ms in a.ms]),
                "ms_per_frame": figures["ms_per_frame"],
            }
        )
    return rows
