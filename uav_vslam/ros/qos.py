# SPDX-License-Identifier: Apache-2.0
"""Quality-of-service profiles by purpose. Profiles inside a vehicle can be overridden in YAML; on the radio they follow
from the communication mode.
"""

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


IMAGE = _reliable(5)  # reliable with the shared-memory profile; best effort loses images without it
IMAGES = _reliable(60)  # for a node that may lag behind them, 3 s at 20 Hz
SENSOR = _reliable(500)  # IMU samples: none may be lost, 2.5 s at 200 Hz
STAMPS = _reliable(100)  # of images, for a node that is behind: each is an increment, and a frame without one is lost
STATE = _reliable(10)
MOTION = _reliable(500, DurabilityPolicy.TRANSIENT_LOCAL)  # increments: none may be lost, not even by a restart
RESUMABLE = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)  # for a back end that is restarted: 14 s to catch up
NEWEST = _reliable(10, DurabilityPolicy.TRANSIENT_LOCAL)  # for those that are restarted, or late
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)  # published once, for late joiners
LATCHED_BY_MANY = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)  # /tf_static: each publisher's message is another

LIFESPAN = Duration(seconds=2)  # an older packet is superseded and need not be sent
DEADLINE = Duration(seconds=3)  # longer gaps between packets are counted
RADIO = {  # by communication mode
    "wideband": _reliable(10),
    # A retransmission would delay the next packet, which supersedes it anyway.
    "narrowband": QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
        lifespan=LIFESPAN,
        deadline=DEADLINE,
    ),
}


def compatible_qos(wanted: QoSProfile, offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return the request that every publisher's offer satisfies: vehicles may be in different modes."""
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
