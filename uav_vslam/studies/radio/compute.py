# SPDX-License-Identifier: Apache-2.0
"""Cost and gain of the packet modes, from flights of the whole node graph: the figures alone, no processes.

All modes replay the same recordings, so their own-only tracks are the same; only the packets' content differs.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.studies.engine.pool import grouped, mean, ratio, rms
from uav_vslam.studies.engine.score_columns import values_of

WIDEBAND, NARROWBAND = "wideband", "narrowband"
MODES = (WIDEBAND, NARROWBAND)
MAX_BYTES_PER_S = {WIDEBAND: 100_000, NARROWBAND: 900}
LARGEST_NARROWBAND_PACKET = 1399  # below 1400 bytes
LEAST_GAIN_KEPT = 0.85

NOTES = {
    "Flights": "two vehicles over rendered farmland, recorded and replayed in lock-step through the whole node graph: "
    "one process a node, packets over DDS. The same recordings in each mode; a seed whose graph failed in one of them "
    "counts in none",
    "ATE": "root mean square over frames, vehicles and seeds, in the common frame without alignment",
    "NEES": "mean over the frames after the 20th, vehicles and seeds",
    "gain_kept_share": "(s - c) / (s - c of wideband) in pooled ATE; none where wideband gains nothing",
    "sent_bytes_per_s": "serialised packets without the headers of RTPS, UDP and IP, as a vehicle's fusion node counts "
    "them; mean and largest over vehicles and seeds",
    "packet_bytes_max": "payload of the largest packet of any vehicle, from the steps of the same counter; in wideband "
    "with the feedback of the same epoch",
    "packets": "sums over vehicles and seeds; sent ones include feedback. Received ones are as of the receiver's last "
    "epoch, so the last may be missing; used: entered a fusion; dropped: refused by the receiver, or (budget) held "
    "back by the sender",
}


@dataclass(frozen=True, slots=True)
class Run:
    """One vehicle's part in one flight.

    Attributes:
        mode, seed: of the flight.
        figures: of the vehicle in `summary.json`.
        packet_bytes: payload of each packet that it sent [B].
    """

    mode: str
    seed: int
    figures: Mapping[str, Any]
    packet_bytes: tuple[int, ...]


def packet_sizes(counters: Iterable[tuple[int, int]]) -> tuple[int, ...]:
    """Return the payload of each packet [B].

    Args:
        counters: packets and bytes sent so far, a pair for each epoch. Where one is missing, its packet and the next
            one's count as one: no packet's size is ever understated.
    """
    sizes, known, total = [], 0, 0
    for packets, size in counters:
        if packets > known:
            sizes.append(size - total)
            known, total = packets, size
    return tuple(sizes)


def radio_rows(runs: Sequence[Run], flights: int) -> list[Row]:
    """Return the rows of `study.json`: the modes, whether the targets are met, and each flight.

    Args:
        runs: of all completed flights.
        flights: started in each mode.
    """
    ended = {mode: {run.seed for run in runs if run.mode == mode} for mode in MODES}
    counted = [run for run in runs if all(run.seed in seeds for seeds in ended.values())]
    rows = {mode: _figures([run for run in counted if run.mode == mode]) for mode in MODES}
    whole = _gain(rows[WIDEBAND]) or 0.0
    for mode, row in rows.items():
        row["gain_kept_share"] = ratio(_gain(row), whole) if whole > 0.0 else None
        row |= {"failures": flights - len(ended[mode]), "runs": flights}
    by_mode = [{TABLE: "Modes", "method": mode, "condition": "all flights", **row} for mode, row in rows.items()]
    return by_mode + _targets(rows) + _flights(runs)


def _figures(runs: Sequence[Run]) -> Row:
    own, fused = rms(_found(runs, "s_slam", "ate_m")), rms(_found(runs, "c_slam", "ate_m"))
    rates = _found(runs, "link", "sent_bytes_per_s")
    counts = {key: int(sum(_found(runs, "link", key))) for key in ("packets_sent", "packets_received", "packets_used")}
    dropped = sum((Counter(run.figures["link"]["dropped"]) for run in runs), Counter())
    return {
        "s_slam_ate_rms_m": own,
        "ate_rms_m": fused,
        "ratio_to_s_slam": ratio(fused, own),
        "s_slam_nees_position": mean(_found(runs, "s_slam", "nees_position")),
        "nees_position": mean(_found(runs, "c_slam", "nees_position")),
        "sent_bytes_per_s": mean(rates),
        "sent_bytes_per_s_max": max(rates, default=None),
        "packet_bytes_max": max((size for run in runs for size in run.packet_bytes), default=None),
        **counts,
        "packets_dropped": ", ".join(f"{count} {reason}" for reason, count in sorted(dropped.items())) or "none",
    }


def _found(runs: Sequence[Run], part: str, key: str) -> list[float]:
    """Return a figure of every run that has it."""
    return values_of([run.figures[part] or {} for run in runs], key)


def _gain(row: Row) -> float | None:
    own, fused = row["s_slam_ate_rms_m"], row["ate_rms_m"]
    return None if own is None or fused is None else own - fused


def _targets(rows: Mapping[str, Row]) -> list[Row]:
    """Return the requirements on the modes, and whether they are met."""
    found = [
        _at_most(mode, "payload [B/s]", rows[mode]["sent_bytes_per_s_max"], MAX_BYTES_PER_S[mode]) for mode in MODES
    ]
    narrow = rows[NARROWBAND]
    found.append(_at_most(NARROWBAND, "largest packet [B]", narrow["packet_bytes_max"], LARGEST_NARROWBAND_PACKET))
    kept = narrow["gain_kept_share"]
    met = kept is not None and kept >= LEAST_GAIN_KEPT
    return [*found, _target(NARROWBAND, "share of the wideband gain", kept, f"at least {LEAST_GAIN_KEPT}", met=met)]


def _at_most(mode: str, what: str, value: float | None, limit: float) -> Row:
    return _target(mode, what, value, f"at most {limit}", met=value is not None and value <= limit)


def _target(mode: str, what: str, measured: float | None, limit: str, *, met: bool) -> Row:
    verdict = {"measured": measured, "limit": limit, "met": "yes" if met else "no"}
    return {TABLE: "Targets", "method": mode, "condition": what, **verdict}


def _flights(runs: Sequence[Run]) -> list[Row]:
    return [
        {TABLE: "Flights", "method": mode, "condition": f"seed {seed}", **_figures(found)}
        for (seed, mode), found in grouped(runs, lambda run: (run.seed, run.mode)).items()
    ]
