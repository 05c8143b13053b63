# SPDX-License-Identifier: Apache-2.0
"""The states that a run over a recorded flight may start from.

recorded    the start state that the recording holds
drawn N     the same with an error drawn from its own covariance by seed N
frame K     the true pose and velocity at a later frame. A recording holds no true biases there, so they are those
            of the recorded start, with the variance of their random walk since then added
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_vslam.config import ImuConfig
from uav_vslam.datasets.starts import drawn_start, true_start
from uav_vslam.errors import UavVslamError
from uav_vslam.studies.engine.recorded_flights import RecordedFlight
from uav_vslam.types import NavEstimate

LATER_SHARES = (0.25, 0.5, 0.75)  # of the frames, where the later starts are


@dataclass(frozen=True, slots=True)
class Start:
    """A start state of a run, and its name."""

    name: str
    estimate: NavEstimate


def starts_of(flight: RecordedFlight, imu: ImuConfig, seeds: Sequence[int]) -> list[Start]:
    """Return the recorded start, one drawn by each seed, and the later ones."""
    drawn = [Start(f"drawn {seed}", drawn_start(flight.initial_state, np.random.default_rng(seed))) for seed in seeds]
    frames = [round(share * len(flight.frame_stamps_ns)) for share in LATER_SHARES]
    later = [Start(f"frame {frame}", start_at_frame(flight, frame, imu)) for frame in frames]
    return [Start("recorded", flight.initial_state), *drawn, *later]


def start_at_frame(flight: RecordedFlight, frame: int, imu: ImuConfig) -> NavEstimate:
    """Return the true start at a frame, see `true_start`.

    Raises:
        UavVslamError: there is no truth at that frame.
    """
    stamp_ns = int(flight.frame_stamps_ns[frame])
    try:
        return true_start(flight.truth, flight.velocities, stamp_ns, flight.initial_state, imu)
    except UavVslamError as error:
        raise UavVslamError(f"{flight.vehicle}, frame {frame}: {error}") from None
