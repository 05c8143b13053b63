# SPDX-License-Identifier: Apache-2.0
"""Flight patterns and disturbances: from legs and turns to a smooth `Trajectory`.

A pattern is a list of segments, each flown for a time while the heading turns by an angle. Turns are coordinated: the
bank follows from the yaw rate. Gusts and airframe vibration are seeded sums of sines, so all their derivatives exist.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.trajectory import Trajectory

Array = NDArray[np.float64]

KNOT_RATE_HZ = 50.0  # twelve knots to the fastest vibration's period
MARGIN_S = 1.0  # motion is defined this long before the first and after the last frame
ROLL_IN_S = 2.0  # a turn's yaw rate is smoothed over this time
LEG_M, CIRCUIT_LEG_M = 300.0, 750.0
SPACING_M = 25.0  # of parallel legs
LEG_TURN_DEG = 15.0  # between straight legs
TOGETHER_S = 60.0  # until vehicles part
BANK_DEG = 25.0  # of the patterns' turns
SINES = 8  # of a disturbance
GRAVITY = 9.80665  # for the bank of a coordinated turn only [m/s^2]


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of flight: `duration_s` long, turning left by `turn_rad`."""

    duration_s: float
    turn_rad: float


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Sum of sines of one signal: amplitude spread evenly over a band, phases and frequencies random.

    Attributes:
        rms: root mean square of the sum, in the unit of the signal.
        low_hz, high_hz: the band.
    """

    rms: float
    low_hz: float
    high_hz: float

    def sample(self, times_s: Array, rng: np.random.Generator) -> Array:
        """Draw one realisation at (N,) times."""
        frequency = np.geomspace(self.low_hz, self.high_hz, SINES) * rng.uniform(0.85, 1.15, SINES)
        phase = rng.uniform(0.0, 2.0 * np.pi, SINES)
        amplitude = self.rms * np.sqrt(2.0 / SINES)
        return np.asarray(amplitude * np.sin(2.0 * np.pi * np.outer(times_s, frequency) + phase).sum(axis=1))


def leg_pattern(duration_s: float, speed: float) -> list[Segment]:
    """Straight legs of 6 s, joined by gentle turns to alternating sides, for at least `duration_s`."""
    del speed
    turn = np.deg2rad(LEG_TURN_DEG)
    cycle = [Segment(6.0, 0.0), Segment(3.0, turn), Segment(6.0, 0.0), Segment(3.0, -turn)]
    return _repeat(cycle, duration_s)


def lawnmower_pattern(duration_s: float, speed: float) -> list[Segment]:
    """Parallel legs `SPACING_M` apart, so that neighbours overlap and places are revisited.

    A plain half turn would put the next leg two turn radii away; the bulb turn (away by alpha, back by pi + 2 alpha,
    away by alpha, with cos alpha = (r + d/2) / 2r) puts it at any smaller distance d.
    """
    radius = _turn_radius_m(speed)
    alpha = np.arccos(min(1.0, (radius + 0.5 * SPACING_M) / (2.0 * radius)))
    leg = Segment(LEG_M / speed, 0.0)

    def arc(turn_rad: float) -> Segment:
        return Segment(abs(turn_rad) * radius / speed, turn_rad)

    def bulb(side: float) -> list[Segment]:
        return [arc(-side * alpha), arc(side * (np.pi + 2.0 * alpha)), arc(-side * alpha)]

    return _repeat([leg, *bulb(1.0), leg, *bulb(-1.0)], duration_s)


def racetrack_pattern(duration_s: float, speed: float, *, leg_m: float = LEG_M) -> list[Segment]:
    """Two legs joined by left half turns, flown repeatedly over the same ground."""
    radius = _turn_radius_m(speed)
    return _repeat([Segment(leg_m / speed, 0.0), Segment(np.pi * radius / speed, np.pi)], duration_s)


def circuit_pattern(duration_s: float, speed: float) -> list[Segment]:
    """A racetrack of 2 km: it revisits its start after one lap, and no other place before."""
    return racetrack_pattern(duration_s, speed, leg_m=CIRCUIT_LEG_M)


def parting_pattern(duration_s: float, speed: float) -> list[Segment]:
    """One straight leg, then a quarter turn to the left, apart from the others; see `MIRRORED`."""
    radius = _turn_radius_m(speed)
    turn = Segment(0.5 * np.pi * radius / speed, 0.5 * np.pi)
    away_s = max(duration_s - TOGETHER_S - turn.duration_s, 0.0) + 2.0 * MARGIN_S
    return [Segment(TOGETHER_S, 0.0), turn, Segment(away_s, 0.0)]


def _turn_radius_m(speed: float) -> float:
    return float(speed**2 / (GRAVITY * np.tan(np.deg2rad(BANK_DEG))))


PATTERNS: dict[str, Callable[[float, float], list[Segment]]] = {
    "leg": leg_pattern,
    "lawnmower": lawnmower_pattern,
    "racetrack": racetrack_pattern,
    "circuit": circuit_pattern,
    "parting": parting_pattern,
}
MIRRORED = ("parting",)  # every second vehicle turns to the other side


def mirrored(segments: list[Segment]) -> list[Segment]:
    """Return the segments with all turns to the other side."""
    return [Segment(s.duration_s, -s.turn_rad) for s in segments]


@dataclass(frozen=True, slots=True)
class Roughness:
    """Disturbances of a flight; the defaults are a small fixed-wing aircraft in light wind."""

    speed: Disturbance = Disturbance(0.4, 0.03, 0.3)  # [m/s]
    lateral: Disturbance = Disturbance(0.4, 0.03, 0.3)  # [m]
    height: Disturbance = Disturbance(0.6, 0.03, 0.3)  # [m]
    roll: Disturbance = Disturbance(np.deg2rad(0.6), 0.5, 4.0)  # [rad]
    pitch: Disturbance = Disturbance(np.deg2rad(0.4), 0.5, 4.0)  # [rad]
    yaw: Disturbance = Disturbance(np.deg2rad(0.3), 0.5, 4.0)  # [rad]


def fly(
    segments: list[Segment],
    *,
    start_ns: int,
    duration_s: float,
    speed: float,
    altitude: float,
    offset_world: tuple[float, float],
    rng: np.random.Generator,
    roughness: Roughness | None = None,
) -> Trajectory:
    """Fly a pattern from the world origin, heading east.

    Args:
        segments: the pattern, at least `duration_s` long.
        start_ns: stamp of the flight's t = 0 [ns].
        duration_s: time for which the motion is needed, beside the margins [s].
        speed: mean ground speed [m/s].
        altitude: mean height over the mean ground [m].
        offset_world: horizontal shift of the whole path: the vehicle's position in the formation [m].
        rng: draws the disturbances.
        roughness: the disturbances' strength.
    """
    rough = roughness or Roughness()
    t = np.arange(-MARGIN_S, duration_s + MARGIN_S + 1.0 / KNOT_RATE_HZ, 1.0 / KNOT_RATE_HZ)
    yaw_rate = _smooth_yaw_rate(segments, t)
    heading = _integral(yaw_rate, t)
    ground_speed = speed + rough.speed.sample(t, rng)
    lateral, height = rough.lateral.sample(t, rng), rough.height.sample(t, rng)
    x = _integral(ground_speed * np.cos(heading), t) - lateral * np.sin(heading) + offset_world[0]
    y = _integral(ground_speed * np.sin(heading), t) + lateral * np.cos(heading) + offset_world[1]
    bank = np.arctan(ground_speed * yaw_rate / GRAVITY)
    climb = np.gradient(height, t) / speed
    rpy = np.stack(
        [
            -bank + rough.roll.sample(t, rng),  # FLU: a left turn lowers the left wing, a negative roll
            -climb + rough.pitch.sample(t, rng),  # FLU: nose up is a negative pitch
            heading + rough.yaw.sample(t, rng),
        ],
        axis=1,
    )
    return Trajectory(start_ns, t, np.stack([x, y, altitude + height], axis=1), rpy)


def _repeat(cycle: list[Segment], duration_s: float) -> list[Segment]:
    segments: list[Segment] = []
    total = 0.0
    while total < duration_s + 2.0 * MARGIN_S:
        segment = cycle[len(segments) % len(cycle)]
        segments.append(segment)
        total += segment.duration_s
    return segments


def _smooth_yaw_rate(segments: list[Segment], t: Array) -> Array:
    """Return the yaw rate at (N,) times: constant in each segment, smoothed by a Hann window."""
    ends = np.cumsum([s.duration_s for s in segments])
    rates = np.array([s.turn_rad / s.duration_s for s in segments])
    raw = rates[np.clip(np.searchsorted(ends, t, side="right"), 0, len(rates) - 1)]
    window = np.hanning(int(ROLL_IN_S * KNOT_RATE_HZ) + 3)
    padded = np.pad(raw, len(window) // 2, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")[: len(t)]


def _integral(rate: Array, t: Array) -> Array:
    """Return the trapezoidal integral of (N,) `rate`, zero at t = 0."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    return np.asarray(total - np.interp(0.0, t, total))
