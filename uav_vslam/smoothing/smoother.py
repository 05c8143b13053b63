# SPDX-License-Identifier: Apache-2.0
"""The most likely states of a whole flight and their covariance: Gauss-Newton from the filter's estimates.

The noise of the pixels is measured from the residuals, so it need not be known for new cameras or another ground.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import FilterDivergence
from uav_vslam.estimation.turning import Turning
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.propagation import NAV_DIM
from uav_vslam.slam.saved_map import Mapped
from uav_vslam.smoothing.arrowhead import Arrowhead, Factor, Marginals, factorise, marginal_covariances
from uav_vslam.smoothing.cameras import Cameras, PixelNoise, RigEstimate
from uav_vslam.smoothing.chain import add_motion, add_rig, add_start, fill_up, moved
from uav_vslam.smoothing.flight import FilteredFlight
from uav_vslam.smoothing.landmarks import PointErrors, smoothed_landmarks
from uav_vslam.smoothing.layout import Layout
from uav_vslam.smoothing.points import fitting, residual_px, revisited, tie_sigma_m, ties, triangulated, wrongly_tied
from uav_vslam.smoothing.sightings import Sightings, gather
from uav_vslam.smoothing.views import Eliminated, add_views, eliminate, linearise
from uav_vslam.types import NavEstimate, NavState

Array = NDArray[np.float64]

MAX_STEPS = 30  # five are usual; heavy tails, and landmarks that are given up, take more
SETTLED = 0.2  # standard deviations by which the last step may move the states, in any direction (Newton decrement)
LOST = 1.0  # standard deviations of the last step with which there is no result, and landmarks can't be judged
GATED_AFTER = 2  # steps: before, the residuals say little about noise and outliers
CUT = 5.0  # of the normalised residual of one observation
GATE_PROBABILITY = 0.9999  # of the chi-square gate on all residuals of a track
SMALLEST_BLOCK = 8  # states: smaller blocks of the normal equations are not faster


@dataclass(frozen=True, slots=True)
class Smoothed:
    """A smoothed flight.

    Attributes:
        estimates: one for each frame, in stamp order.
        points, dropped: used, and refused by the gate.
        landmarks: seen again after long, that close loops.
        noise: of the pixels, as measured.
        mapped: the filter's landmarks, smoothed; None if none were given.
    """

    estimates: tuple[NavEstimate, ...]
    points: int
    dropped: int
    landmarks: int
    noise: PixelNoise
    mapped: Mapped | None


@dataclass(frozen=True, slots=True)
class _Step:
    """A step of Gauss-Newton that was taken, with the normal equations before it.

    Attributes:
        decrement: Newton decrement.
        layout: of the normal equations.
        factor: the same, the border's covariance with the uncertainty of the calibration.
        sightings, batches: of the points, and these eliminated.
    """

    decrement: float
    layout: Layout
    factor: Factor
    sightings: Sightings
    batches: list[tuple[slice, Eliminated]]

    def point_errors(self, marginals: Marginals) -> PointErrors:
        """Return the errors of the points."""
        return PointErrors(self.sightings, self.batches, self.layout, self.factor, marginals)


class _Problem:
    """What Gauss-Newton moves, and what it fits: states, rig, points (P, 7) and revisited landmarks (L, 3)."""

    def __init__(self, flight: FilteredFlight, rig: StereoRig, config: VehicleConfig) -> None:
        self._flight, self._config = flight, config
        self.states: list[NavState] = flight.states
        known = dataclasses.replace(config.rig, flexing=config.rig.flexing or flight.flexing)
        self.rig = RigEstimate.of(rig, known, len(self.states))
        self.sightings: Sightings = gather(flight)
        self.points = triangulated(self.sightings, self._cameras)
        self.landmarks = np.zeros((0, 3))
        self._noise_of = PixelNoise.of_tracks if self.sightings.tracked else PixelNoise.of_detections
        self.noise = self._noise_of(config.backend.sigma_px)
        self.keep(np.asarray(np.isfinite(self.points).all(axis=1)))

    def keep(self, chosen: NDArray[np.bool_]) -> None:
        """Drop all other points."""
        self.sightings, self.points = self.sightings.chosen(chosen), self.points[chosen]
        self.landmarks = revisited(self.sightings, self.points)

    def untie(self) -> bool:
        """Give up the landmarks that were recognised wrongly; return whether there were any."""
        wrong = wrongly_tied(
            self.sightings.landmarks, self.points, self.landmarks, self._tie_sigma_m, probability=GATE_PROBABILITY
        )
        self.sightings = self.sightings.untied(wrong)
        self.landmarks = np.delete(self.landmarks, wrong, axis=0)
        return len(wrong) > 0

    def gate(self) -> None:
        """Measure the noise of the pixels, and drop points that don't fit."""
        cameras = self._cameras
        found = residual_px(self.sightings, cameras, self.points, self.noise)
        if found is not None:
            self.noise = self._noise_of(found)
        self.noise = dataclasses.replace(self.noise, cut=CUT)
        self.keep(fitting(self.sightings, cameras, self.points, self.noise, probability=GATE_PROBABILITY))

    def step(self) -> _Step:
        """Take a step."""
        layout = self.layout
        system = Arrowhead.zeros(layout.blocks, layout.size * layout.stride, layout.border)
        add_start(system, self._flight.start, self.states[0])
        add_motion(system, layout, self.states, self._flight.increments, self._config.imu)
        add_rig(system, layout, self.rig)
        fill_up(system, layout)
        batches = self._add_points(system, layout)
        factor = factorise(system)
        steps = factor.solution.reshape(-1, layout.stride)[: layout.states]
        rig_step, landmark_steps = np.split(factor.border_solution, [layout.rig])
        landmark_steps = landmark_steps.reshape(-1, 3)
        of_points = np.vstack([landmark_steps, np.zeros((1, 3))])[self.sightings.landmarks]  # the last row: of none
        for own, eliminated in batches:
            self.points[own] += eliminated.corrections(steps[:, layout.seen], rig_step, of_points[own])
        self.states = moved(self.states, steps[:, :NAV_DIM])
        rig = self.rig.moved(rig_step, steps[:, NAV_DIM:])
        self.rig = rig.judged(factor.border_covariance)
        self.landmarks = self.landmarks + landmark_steps
        decrement = float(np.sum(factor.solution * system.rhs) + factor.border_solution @ system.border_rhs)
        claiming = dataclasses.replace(factor, border_covariance=rig.claimed(factor.border_covariance))
        return _Step(max(decrement, 0.0) ** 0.5, layout, claiming, self.sightings, batches)

    @property
    def layout(self) -> Layout:
        """Where the unknowns are: a block of states is as long as the longest track."""
        return Layout(
            states=len(self.states),
            size=max(self.sightings.longest, SMALLEST_BLOCK),
            vibration=3 if self.rig.vibrates else 0,
            rig=self.rig.errors.dim,
            landmarks=len(self.landmarks),
        )

    def _add_points(self, system: Arrowhead, layout: Layout) -> list[tuple[slice, Eliminated]]:
        cameras, batches = self._cameras, []
        sigma_m = self._tie_sigma_m
        for block, own, part in self.sightings.by_block(layout.size):
            tied = ties(part.landmarks, self.points[own], self.landmarks, sigma_m[own])
            view = linearise(part, cameras, self.points[own], self.noise)
            eliminated = eliminate(part, view, self.points[own], self.noise, tied)
            add_views(system, layout, block, view, eliminated, tied)
            batches.append((own, eliminated))
        return batches

    @property
    def _tie_sigma_m(self) -> Array:
        redetection_px = max(self._config.backend.redetection_px, self.noise.white_px)
        return tie_sigma_m(self.sightings, self._cameras, self.points, redetection_px)

    @property
    def _cameras(self) -> Cameras:
        increments = self._flight.increments
        if not increments:
            return Cameras(self.states, [Turning.none()], self.rig)
        first = Turning.at_start(increments[0], self.states[0])
        later = (Turning.at_end(*each) for each in zip(increments, self.states[1:], strict=True))
        return Cameras(self.states, [first, *later], self.rig)


def smooth(flight: FilteredFlight, rig: StereoRig, config: VehicleConfig, mapped: Mapped | None = None) -> Smoothed:
    """Smooth a flight.

    Args:
        flight: measurements, and estimates to start from.
        rig: calibration; its errors are estimated with the filter's priors.
        config: of the vehicle; `backend.sigma_px` counts only where points are too few to measure it.
        mapped: the filter's landmarks, to be smoothed too.

    Raises:
        FilterDivergence: the normal equations are not positive definite, or the steps did not settle.
    """
    problem = _Problem(flight, rig, config)
    found = len(problem.points)
    for step in range(1, MAX_STEPS + 1):
        if step == GATED_AFTER + 1:
            problem.gate()
        last = None  # its memory, as the next step needs as much again
        last = problem.step()
        near = step > GATED_AFTER and last.decrement < LOST
        if near and not problem.untie() and last.decrement < SETTLED:
            break
    assert last is not None
    if not last.decrement < LOST:
        raise FilterDivergence(f"after {step} steps the smoothed states still moved by {last.decrement:.1f} sigma")
    marginals = marginal_covariances(last.factor)
    estimates = []
    for row in flight.state_rows.tolist():
        block, own = last.layout.place(row)
        estimates.append(NavEstimate(problem.states[row], marginals.blocks[block, own, own].copy()))
    if mapped is not None:
        end_ns, positions = estimates[-1].state.stamp_ns, problem.points[:, :3]
        mapped = smoothed_landmarks(mapped, positions, last.point_errors(marginals), stamp_ns=end_ns)
    return Smoothed(
        tuple(estimates),
        points=len(problem.points),
        dropped=found - len(problem.points),
        landmarks=len(problem.landmarks),
        noise=problem.noise,
        mapped=mapped,
    )
