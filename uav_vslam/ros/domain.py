# SPDX-License-Identifier: Apache-2.0
"""Finds a free ROS domain on this host and holds it; imports no ROS."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from uav_vslam.errors import ConfigError

MAX_DOMAIN_ID = 101  # above, DDS ports collide with those that Linux gives to clients
HIGHEST_DOMAIN_ID = 232  # of which DDS can compute ports
MAX_PARTICIPANTS = 120  # of a domain on one host; more would use the next domain's ports


def check_domain(domain_id: int | None) -> None:
    """Refuse a number that is no usable ROS domain; None is the environment's.

    Raises:
        ConfigError: it is not.
    """
    if domain_id is None:
        _check_environment(os.environ.get("ROS_DOMAIN_ID", "").strip())
    elif not 0 <= domain_id <= MAX_DOMAIN_ID:
        raise ConfigError(f"--domain {domain_id} is not allowed; use 0 to {MAX_DOMAIN_ID}")


def _check_environment(text: str) -> None:
    """Refuse a number at which ROS or DDS would fail, and a negative one, which ROS takes for 0."""
    if text and not (text.isdecimal() and int(text) <= HIGHEST_DOMAIN_ID):
        raise ConfigError(f"ROS_DOMAIN_ID={text} in the environment is not allowed; use 0 to {MAX_DOMAIN_ID}")


@contextmanager
def claimed_domain() -> Iterator[int]:
    """Hold a ROS domain without a participant on this host and without another claim.

    The claim is an abstract Unix socket. The kernel keeps those per network namespace, as it does the ports of DDS,
    and releases a claim when its process exits in any way: no file remains.
    """
    first = os.getpid() % MAX_DOMAIN_ID
    for domain_id in (1 + (first + step) % MAX_DOMAIN_ID for step in range(MAX_DOMAIN_ID)):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
            if _bound(claim, f"\0uav_vslam/ros_domain/{domain_id}") and not _has_participant(domain_id):
                yield domain_id
                return
    raise ConfigError(f"all {MAX_DOMAIN_ID} ROS domains are in use on this host; give one with --domain")


def _has_participant(domain_id: int) -> bool:
    """Return whether a participant without a claim uses the domain, such as a node that takes its time to end.

    A participant takes the first free one of the domain's unicast ports, the others keep theirs when it leaves.
    """
    first = 7400 + 250 * domain_id + 10  # OMG DDSI-RTPS, default port numbers
    return any(_in_use(port) for port in range(first, first + 2 * MAX_PARTICIPANTS, 2))


def _in_use(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        return not _bound(probe, ("", port))


def _bound(endpoint: socket.socket, address: str | tuple[str, int]) -> bool:
    try:
        endpoint.bind(address)
    except OSError:
        return False
    return True
