# SPDX-License-Identifier: Apache-2.0
"""A live fleet as tables for the terminal, and as lines for a log."""

import math

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from uav_vslam.monitor import ERROR, OK, SILENT, STREAMS, WARN, Fleet, Health, Link, Peer, Stream, Vehicle
from uav_vslam.report.layout import ABSENT, figure_text, new_table

LEVELS = {OK: "ok", WARN: "warning", ERROR: "error", SILENT: "silent"}
STYLES = {OK: "green", WARN: "yellow", ERROR: "bold red", SILENT: "bold red"}
NAMES = dict(zip(STREAMS, ("IMU", "INS", "Feat.", "Odom.", "Fused"), strict=True))
TITLES = (
    *(f"{name}\n[Hz]" for name in NAMES.values()),
    "1σ own\n[m]",
    "1σ fus.\n[m]",
    "1σ yaw\n[deg]",
    "Land-\nmarks",
)
RADIO_LABELS = ("Vehicle", "Mode", "Sent\n[kB/s]", "Peer")
RADIO_TITLES = ("Rcvd.\n[kB/s]", "Pack-\nets", "Used", "Drop-\nped", "Common\nland-\nmarks", "Age\n[s]")


def live_view(fleet: Fleet, now_s: float) -> RenderableType:
    """Return the tables of estimates and of the radio, then what is wrong, the worst first."""
    vehicles = list(fleet.vehicles.values())
    parts: list[RenderableType] = [_estimates(vehicles, now_s), _radio(vehicles)] if vehicles else []
    return Group(*parts, *(Text(text, style) for text, style in _remarks(fleet, now_s)))


def live_lines(fleet: Fleet, now_s: float) -> list[str]:
    """Return what `live_view` shows as one line a vehicle, and one for each node that is not well."""
    lines = [_line(vehicle, now_s) for vehicle in fleet.vehicles.values() if vehicle.age_s(now_s) is not None]
    return lines + [text for text, _ in _remarks(fleet, now_s)]


def _estimates(vehicles: list[Vehicle], now_s: float) -> Table:
    table = new_table(("Vehicle",), TITLES)
    for vehicle in vehicles:
        silent = vehicle.is_silent(now_s)  # a line below says for how long
        rates = [Text(ABSENT) if silent else _rate(vehicle.streams[name], now_s) for name in STREAMS]
        own, fused = vehicle.own, vehicle.fused
        figures = (
            figure_text(own and own.sigma_m),
            figure_text(fused and fused.sigma_m),
            _heading(vehicle),
            ABSENT if vehicle.landmarks is None else str(vehicle.landmarks),
        )
        table.add_row(vehicle.name, *rates, *figures, style="dim" if silent else None)
    return table


def _heading(vehicle: Vehicle) -> str:
    """Return 1 sigma of the heading [deg], of the fused estimate if there is one."""
    claim = vehicle.fused or vehicle.own
    return figure_text(claim and math.degrees(claim.sigma_heading_rad))


def _rate(stream: Stream, now_s: float) -> Text:
    """Return a rate, or how long ago a stream has stopped."""
    rate_hz = stream.rate_hz(now_s)
    if stream.is_silent(now_s):
        return Text(f"0\n({stream.age_s(now_s):.0f} s)", "bold red")  # two lines: the table fits into 80 columns
    return Text(ABSENT if rate_hz is None else f"{rate_hz:.1f}")


def _radio(vehicles: list[Vehicle]) -> Table:
    """Return a row for each pair of a vehicle and a peer."""
    table = new_table(RADIO_LABELS, RADIO_TITLES)
    for vehicle in vehicles:
        peers = vehicle.link.peers if vehicle.link else ()
        own = (vehicle.name, vehicle.mode or ABSENT, _sent(vehicle.link))
        for k, peer in enumerate(peers):
            table.add_row(*(own if k == 0 else ("", "", "")), *_peer_cells(peer), style="red" if peer.silent else None)
        if not peers:
            table.add_row(*own, "none received" if vehicle.link else ABSENT)
    return table


def _sent(link: Link | None) -> str:
    if link is None:
        return ABSENT
    wire = link.wire_sent_bytes_per_s
    return f"{link.sent_bytes_per_s / 1e3:.2f}" + ("" if wire is None else f" ({wire / 1e3:.2f} with headers)")


def _peer_cells(peer: Peer) -> tuple[str, ...]:
    return (
        f"{peer.name} (silent)" if peer.silent else peer.name,
        f"{peer.received_bytes_per_s / 1e3:.2f}",
        str(peer.packets_received),
        str(peer.packets_used),
        str(peer.packets_dropped),
        str(peer.common_landmarks),
        f"{peer.age_s:.1f}",
    )


def _remarks(fleet: Fleet, now_s: float) -> list[tuple[str, str]]:
    """Return lines with their styles: vehicles awaited, nodes that are not well, messages dropped."""
    missing = fleet.missing
    if not fleet.vehicles:
        return [("waiting for a vehicle: none on this ROS domain so far; is it the nodes' domain?", STYLES[WARN])]
    remarks = [(f"waiting for {', '.join(missing)}: nothing received so far", STYLES[WARN])] if missing else []
    silent = {vehicle.name for vehicle in fleet.vehicles.values() if vehicle.is_silent(now_s)}
    for name in sorted(silent):
        remarks.append((f"{name} silent for {fleet.vehicles[name].age_s(now_s):.0f} s", STYLES[SILENT]))
    health = [one for one in fleet.health(now_s) if one.vehicle not in silent]
    remarks += [(_health_text(one), STYLES.get(one.level, STYLES[ERROR])) for one in health if one.level != OK]
    if health and all(one.level == OK for one in health):
        remarks.append((f"all {len(health)} nodes that report are well", STYLES[OK]))
    for vehicle in fleet.vehicles.values():
        if vehicle.dropped:
            remarks.append((f"{vehicle.name} dropped {_counts(vehicle.dropped)}", ""))
        if vehicle.coasted:
            remarks.append((f"{vehicle.name} coasted {vehicle.coasted} of {vehicle.frames} frames", ""))
    return remarks


def _health_text(health: Health) -> str:
    return f"{LEVELS.get(health.level, 'error')}: {health.vehicle} {health.node}: {health.text}"


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.items())


def _line(vehicle: Vehicle, now_s: float) -> str:
    rates = ", ".join(f"{NAMES[name]} {_rate(vehicle.streams[name], now_s)}" for name in STREAMS).replace("\n", " ")
    own, fused, link = vehicle.own, vehicle.fused, vehicle.link
    received = sum(peer.received_bytes_per_s for peer in link.peers) if link else None
    return (
        f"{vehicle.name}: {rates} Hz; 1σ own {figure_text(own and own.sigma_m)}, "
        f"fused {figure_text(fused and fused.sigma_m)} m, heading {_heading(vehicle)} deg; "
        f"landmarks {ABSENT if vehicle.landmarks is None else vehicle.landmarks}; "
        f"{vehicle.mode or 'mode unknown'}, sent {_sent(link)}, "
        f"received {ABSENT if received is None else f'{received / 1e3:.2f}'} kB/s"
    )
