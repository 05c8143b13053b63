# SPDX-License-Identifier: Apache-2.0
"""Settings of a whole fleet: its vehicles, the replay of recordings, and the emulated radio link."""

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from uav_vslam.config.settings import Settings, refuse, setting
from uav_vslam.config.vehicle import VehicleConfig
from uav_vslam.errors import ConfigError


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
class RadioConfig(Settings):
    """The radio between vehicles that have a computer each."""

    domain_id: int = setting(-1, "ROS domain of the radio; -1: the vehicles' own", at_least=-1, at_most=232)
    interface: str = setting("", "network interface whose traffic is reported; empty for none")


@dataclass(frozen=True, slots=True)
class FleetConfig:
    """A fleet description.

    Attributes:
        vehicles: configurations by name, which is the ROS namespace.
        replay: recordings, if any.
        radio: between computers; vehicles that are launched together don't need it.
        addresses: of vehicles on the radio, by name; of all or of none.
    """

    vehicles: dict[str, VehicleConfig]
    replay: ReplayConfig
    radio: RadioConfig = field(default_factory=RadioConfig)
    addresses: dict[str, str] = field(default_factory=dict)

    def changed(
        self, *, bags: Sequence[Path] | None = None, rate: float | None = None, mode: str | None = None
    ) -> "FleetConfig":
        """Return the fleet with other recordings, pace or communication mode, where given."""
        replay, vehicles = self.replay, self.vehicles
        if bags:
            replay = dataclasses.replace(replay, bags=tuple(bags))
        if rate is not None:
            replay = dataclasses.replace(replay, rate=rate)
        if mode is not None:
            vehicles = {
                name: dataclasses.replace(config, fusion=dataclasses.replace(config.fusion, mode=mode))
                for name, config in vehicles.items()
            }
        return dataclasses.replace(self, vehicles=vehicles, replay=replay)

    def chosen(self, vehicles: Collection[str]) -> dict[str, VehicleConfig]:
        """Return the configurations of some vehicles by name, in the fleet's order; none: of all.

        Raises:
            ConfigError: one is not of the fleet.
        """
        for name in vehicles:
            if name not in self.vehicles:
                raise ConfigError(f"vehicle {name!r} is not in the fleet file, which has {', '.join(self.vehicles)}")
        return {name: config for name, config in self.vehicles.items() if name in vehicles or not vehicles}
