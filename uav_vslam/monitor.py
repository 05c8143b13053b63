# SPDX-License-Identifier: Apache-2.0
"""State of a live fleet: rates of its streams, what its estimates claim, its radio, and its nodes' health.

Times are of a monotonic wall clock [s] and given by the caller.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

WINDOW_S = 5.0  # over which a rate is measured
SILENT_S = 3.0  # nodes report once a second; a stream or node is silent after this time,
SILENT_PERIODS = 5.0  # or so many of its periods, whichever is longer
STREAMS = ("imu", "ins", "features", "odometry", "fused")
OK, WARN, ERROR, SILENT = 0, 1, 2, 3  # levels of health: those of diagnostic_msgs, whose STALE is 3
SEVERITY = {ERROR: 0, SILENT: 1, WARN: 2, OK: 3}
DROPPED = "dropped/"  # prefix of the diagnostics' counters of dropped messages


@dataclass(slots=True)
class Stream:
    """Arrivals of one topic's messages."""

    _arrivals_s: deque[float] = field(default_factory=deque)

    def arrived(self, now_s: float) -> None:
        """Count a message."""
        self._arrivals_s.append(now_s)
        while now_s - self._arrivals_s[0] > WINDOW_S and len(self._arrivals_s) > 2:
            self._arrivals_s.popleft()

    @property
    def has_begun(self) -> bool:
        """Whether a message ever came."""
        return bool(self._arrivals_s)

    def rate_hz(self, now_s: float) -> float | None:
        """Return the rate over the window, falling as soon as a message is overdue; None before the second message."""
        intervals = len(self._arrivals_s) - 1
        if intervals < 1:
            return None
        first_s, last_s = self._arrivals_s[0], self._arrivals_s[-1]
        return min(intervals / max(last_s - first_s, 1e-9), (intervals + 1) / max(now_s - first_s, 1e-9))

    def age_s(self, now_s: float) -> float | None:
        """Return the time since the last message; None before the first."""
        return now_s - self._arrivals_s[-1] if self._arrivals_s else None

    def is_silent(self, now_s: float) -> bool:
        """Return whether a stream that had begun has stopped."""
        if not self._arrivals_s:
            return False
        intervals = len(self._arrivals_s) - 1
        period_s = (self._arrivals_s[-1] - self._arrivals_s[0]) / intervals if intervals else 0.0
        return now_s - self._arrivals_s[-1] > max(SILENT_S, SILENT_PERIODS * period_s)


@dataclass(frozen=True, slots=True)
class Claim:
    """What an estimate claims of its newest pose.

    Attributes:
        sigma_m: 1 sigma of the position, the root of its covariance's trace [m].
        sigma_heading_rad: 1 sigma of the heading [rad].
    """

    sigma_m: float
    sigma_heading_rad: float

    @classmethod
    def of(cls, covariance: Sequence[float]) -> "Claim":
        """Read a covariance (36,), row-major over position [m] and rotation [rad] about the map's axes."""
        return cls(max(sum(covariance[k] for k in (0, 7, 14)), 0.0) ** 0.5, max(covariance[35], 0.0) ** 0.5)


@dataclass(frozen=True, slots=True)
class Peer:
    """Reception of one peer; the fields are those of uav_vslam_msgs/PeerLink, drops of all reasons together."""

    name: str
    packets_received: int
    packets_used: int
    packets_dropped: int
    received_bytes_per_s: float
    common_landmarks: int
    age_s: float
    silent: bool


@dataclass(frozen=True, slots=True)
class Link:
    """A vehicle's side of the radio.

    Attributes:
        mode: communication mode.
        sent_bytes_per_s: payload sent over the last 10 s.
        wire_sent_bytes_per_s: all that the radio's interface sends; None if not measured.
        peers: by name.
    """

    mode: str
    sent_bytes_per_s: float
    wire_sent_bytes_per_s: float | None
    peers: tuple[Peer, ...]


@dataclass(frozen=True, slots=True)
class NodeReport:
    """A node's last diagnostics.

    Attributes:
        level, text: its health.
        values: what it reports besides.
        heard_s: when.
    """

    level: int
    text: str
    values: dict[str, str]
    heard_s: float


@dataclass(frozen=True, slots=True)
class Health:
    """A node's health now: that of its last report, or SILENT without a recent one."""

    vehicle: str
    node: str
    level: int
    text: str


@dataclass(slots=True)
class Vehicle:
    """What is known of one vehicle.

    Attributes:
        name: of the vehicle.
        streams: by the names in `STREAMS`.
        own, fused: claims of the two estimates.
        frames, coasted: frames received, and those of them without a visual update.
        landmarks: in the filter's state.
        link: the radio as of the last epoch.
        nodes: last reports by the node's name.
    """

    name: str
    streams: dict[str, Stream] = field(default_factory=lambda: {name: Stream() for name in STREAMS})
    own: Claim | None = None
    fused: Claim | None = None
    frames: int = 0
    coasted: int = 0
    landmarks: int | None = None
    link: Link | None = None
    nodes: dict[str, NodeReport] = field(default_factory=dict)

    def on_frame(self, *, landmarks: int, coasted: bool) -> None:
        """Take the quality of a frame."""
        self.frames += 1
        self.coasted += coasted
        self.landmarks = landmarks

    @property
    def is_heard(self) -> bool:
        """Whether anything was ever received."""
        return bool(self.nodes) or any(stream.has_begun for stream in self.streams.values())

    def age_s(self, now_s: float) -> float | None:
        """Return the time since anything was received; None before."""
        streams = [age_s for stream in self.streams.values() if (age_s := stream.age_s(now_s)) is not None]
        return min([*streams, *(now_s - report.heard_s for report in self.nodes.values())], default=None)

    def is_silent(self, now_s: float) -> bool:
        """Return whether nothing comes any more."""
        age_s = self.age_s(now_s)
        return age_s is not None and age_s > SILENT_S

    @property
    def mode(self) -> str:
        """Communication mode; empty if not yet known."""
        if self.link is not None:
            return self.link.mode
        fusion = self.nodes.get("fusion")
        return "" if fusion is None else fusion.values.get("mode", "")

    @property
    def dropped(self) -> dict[str, int]:
        """Messages dropped since the nodes' start, by reason, most first."""
        counts: dict[str, int] = {}
        for report in self.nodes.values():
            for key, value in report.values.items():
                if key.startswith(DROPPED) and value.isdigit() and int(value):
                    reason = key.removeprefix(DROPPED)
                    counts[reason] = counts.get(reason, 0) + int(value)
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    def health(self, now_s: float) -> list[Health]:
        """Return the health of each node that ever reported."""
        return [self._health(node, report, now_s) for node, report in self.nodes.items()]

    def _health(self, node: str, report: NodeReport, now_s: float) -> Health:
        age_s = now_s - report.heard_s
        if age_s > SILENT_S:
            return Health(self.name, node, SILENT, f"no report for {age_s:.0f} s")
        return Health(self.name, node, report.level, report.text)


class Fleet:
    """The vehicles that are watched.

    Attributes:
        vehicles: by name.
    """

    def __init__(self, names: Sequence[str] = ()) -> None:
        """Watch the vehicles of these names, or without any name all that are found."""
        self._fixed = bool(names)
        self.vehicles: dict[str, Vehicle] = {name: Vehicle(name) for name in names}

    def vehicle(self, name: str) -> Vehicle | None:
        """Return a vehicle by name, None if it is not to be watched; an unknown one is added."""
        if not self._fixed and name not in self.vehicles:
            self.vehicles = dict(sorted([*self.vehicles.items(), (name, Vehicle(name))]))
        return self.vehicles.get(name)

    @property
    def missing(self) -> list[str]:
        """Names of the vehicles from which nothing has come yet."""
        return [name for name, vehicle in self.vehicles.items() if not vehicle.is_heard]

    @property
    def is_complete(self) -> bool:
        """Whether there is a vehicle, and something has come from each."""
        return bool(self.vehicles) and not self.missing

    def health(self, now_s: float) -> list[Health]:
        """Return the health of all nodes, the worst first."""
        found = [health for vehicle in self.vehicles.values() for health in vehicle.health(now_s)]
        return sorted(found, key=lambda health: (SEVERITY.get(health.level, 0), health.vehicle, health.node))
