# SPDX-License-Identifier: Apache-2.0
"""Settings of a whole fleet: its vehicles, the replay of recordings, and the emulated radio link."""

from dataclasses import dataclass
from pathlib import Path

from uav_vslam.config.settings import Settings, refuse, setting
from uav_vslam.config.vehicle import VehicleConfig


@dataclass(frozen=True, slots=True)
class ReplayConfig(Settings):
    """The replay of recordings."""

    bags: tuple[Path, ...] = setting((), "recordings that together hold every vehicle's topics")
    rate: float = setting(
        0.0, "multiple of real time; 0: paced by the graph's own progress (lock-step), no frame is lost", at_least=0
    )
    timeout_s: float = setting(
        60.0, "lock-step aborts when a vehicle has not answered for this long", unit="s", above=0
    )


@dataclass(frozen=True, slots=True)
class LinkConfig(Settings):
    """The effects of an emulated radio link on packets; by default it is perfect."""

    rate_bytes_per_s: float = setting(0.0, "rate; 0: unlimited", unit="B/s", at_least=0)
    burst_bytes: int = setting(
        1500, "sent at once after a pause; the rest of a larger packet waits for the rate", unit="B", at_least=0
    )
    queue_bytes: int = setting(16384, "capacity; a packet that does not fit is dropped", unit="B", at_least=0)
    delay_s: float = setting(0.0, "from leaving the queue to arrival", unit="s", at_least=0)
    jitter_s: float = setting(
        0.0, "further delay, uniform up to this for each packet, so that packets are reordered", unit="s", at_least=0
    )
    loss: float = setting(0.0, "share of the packets that never arrive", at_least=0, at_most=1)
    duplication: float = setting(0.0, "share of the packets that arrive twice", at_least=0, at_most=1)
    blackouts: tuple[float, ...] = setting(
        (), "start, end, start, end, ... since the first packet; all packets between are lost", unit="s"
    )
    seed: int = setting(0, "seed of all random draws", at_least=0)

    def _check_together(self) -> None:
        odd, spans = len(self.blackouts) % 2, self.blackout_spans
        if odd or not all(0 <= start < end for start, end in spans):
            refuse("blackouts", self.blackouts, "pairs start, end with 0 <= start < end")

    @property
    def blackout_spans(self) -> list[tuple[float, float]]:
        """[start, end) of each blackout since the first packet [s]."""
        return list(zip(self.blackouts[::2], self.blackouts[1::2], strict=False))


@dataclass(frozen=True, slots=True)
class FleetConfig:
    """A fleet description: vehicle configurations by name (the name is the ROS namespace), and what is replayed."""

    vehicles: dict[str, VehicleConfig]
    replay: ReplayConfig
