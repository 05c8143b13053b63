# SPDX-License-Identifier: Apache-2.0
"""Quality-of-service profiles by purpose. All publishers and subscriptions accept overrides from YAML."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


IMAGE = _reliable(5)  # reliable with the shared-memory profile; best effort loses images without it
SENSOR = _reliable(500)  # inertial readings: none may be missing, 2.5 s at 200 Hz
STATE = _reliable(10)
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)  # said once, for whoever comes later
WIDEBAND = _reliable(10)  # packets over the radio
