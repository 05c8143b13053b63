# SPDX-License-Identifier: Apache-2.0
"""Quality-of-service profiles by purpose. What stays in the vehicle accepts overrides from YAML; on the radio the
communication mode decides.
"""

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


IMAGE = _reliable(5)  # reliable with the shared-memory profile; best effort loses images without it
SENSOR = _reliable(500)  # inertial readings and increments: none may be missing, 2.5 s at 200 Hz
STATE = _reliable(10)
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)  # said once, for whoever comes later

LIFESPAN = Duration(seconds=2)  # an older packet has been replaced by a newer one: it need not be sent any more
DEADLINE = Duration(seconds=3)  # a longer time without a packet is counted
RADIO = {  # by communication mode
    "wideband": _reliable(10),
    # A packet sent again would take the place of the next one, which replaces it anyway.
    "narrowband": QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
        lifespan=LIFESPAN,
        deadline=DEADLINE,
    ),
}


def asking_no_more(wanted: QoSProfile, offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return what to ask for so that every publisher's offer meets it: vehicles may be in different modes."""
    reliable = wanted.reliability == ReliabilityPolicy.RELIABLE and all(
        offer.reliability != ReliabilityPolicy.BEST_EFFORT for offer in offers
    )
    timely = all(0 < offer.deadline.nanoseconds <= wanted.deadline.nanoseconds for offer in offers)
    return QoSProfile(
        history=wanted.history,
        depth=wanted.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=wanted.durability,
        lifespan=wanted.lifespan,
        deadline=wanted.deadline if timely else Duration(),  # zero stands for none
    )
