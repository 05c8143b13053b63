# SPDX-License-Identifier: Apache-2.0
"""Types of messages and their names, as in "sensor_msgs/msg/Imu"."""

from importlib import import_module
from typing import Any

from uav_vslam.errors import UavVslamError


def type_name(message_type: Any) -> str:
    """Return the name of a type."""
    return f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"


def type_named(name: str, *, topic: str) -> Any:
    """Return the type of a topic's messages.

    Raises:
        UavVslamError: it is not installed.
    """
    package, _, message = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError):
        raise UavVslamError(f"{topic}: {name} is not installed; build it and source its workspace") from None
