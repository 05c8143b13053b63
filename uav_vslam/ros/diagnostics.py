# SPDX-License-Identifier: Apache-2.0
"""The status of one node as a message."""

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header


def status_message(
    name: str,
    values: Mapping[str, str],
    *,
    level: bytes = DiagnosticStatus.OK,
    text: str = "",
    vehicle: str = "",
    stamp: Time | None = None,
) -> DiagnosticArray:
    """Return the status of a node.

    Args:
        name: "OWNER: NODE", as monitors of diagnostics group them.
        values: further figures, by name.
        level, text: how the node is.
        vehicle: whose hardware it runs on; empty for nodes of the whole fleet.
        stamp: time of the status; None for none.
    """
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    status = DiagnosticStatus(level=level, name=name, message=text, hardware_id=vehicle, values=pairs)
    return DiagnosticArray(header=Header(stamp=stamp or Time()), status=[status])
