# SPDX-License-Identifier: Apache-2.0
"""How a node's messages travel on its host: by the environment in which the process joins a domain.

Images need shared memory: best effort over UDP loses them. Whatever else passes does without, for a process that is
killed while it writes to another's shared memory leaves it locked, and that one never receives anything again.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from uav_vslam.config import find_dds_profile

PROFILES_FILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
DISCOVERY_RANGE, STATIC_PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"


def is_for_images() -> bool:
    """Whether the environment leaves this process the profile for images: the user has chosen no other.

    Raises:
        ConfigError: the profiles are not installed.
    """
    images = find_dds_profile("images.xml")
    chosen = Path(os.environ.get(PROFILES_FILE) or images)  # `env.sh` names that one, for programs that aren't ours
    return chosen.resolve() == images.resolve()


def udp_alone() -> dict[str, str]:
    """Return the variables for a process that sees its own host only; none if the user has chosen another profile.

    Raises:
        ConfigError: the profiles are not installed.
    """
    own_host_only = os.environ.get(DISCOVERY_RANGE) == "LOCALHOST" and not os.environ.get(STATIC_PEERS)
    if not is_for_images() or not own_host_only:
        return {}
    # The range is the profile's: LOCALHOST would add shared memory.
    return {PROFILES_FILE: str(find_dds_profile("messages.xml")), DISCOVERY_RANGE: "SYSTEM_DEFAULT"}


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables temporarily."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            del os.environ[name]
            if value is not None:
                os.environ[name] = value
