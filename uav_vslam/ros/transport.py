# SPDX-License-Identifier: Apache-2.0
"""How a node's messages travel on its host: by the Fast DDS profile that the process reads when it joins a domain.

Images need shared memory: best effort over UDP loses them. Whatever else passes does without, for a process that is
killed while it writes to another's shared memory leaves it locked, and that one never hears anybody again.
"""

import os
from pathlib import Path

from uav_vslam.config import find_dds_profile

PROFILES_FILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
DISCOVERY_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def do_without_shared_memory() -> None:
    """Let this process use UDP alone, if it is to see its own host only and the user has chosen no profile.

    Raises:
        ConfigError: the profiles are not installed.
    """
    images = find_dds_profile("images.xml")
    chosen = Path(os.environ.get(PROFILES_FILE) or images)  # `env.sh` names that one, for programs that aren't ours
    own_host_only = os.environ.get(DISCOVERY_RANGE) == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS")
    if own_host_only and chosen.resolve() == images.resolve():
        os.environ[PROFILES_FILE] = str(find_dds_profile("messages.xml"))
        os.environ[DISCOVERY_RANGE] = "SYSTEM_DEFAULT"  # the profile's: LOCALHOST would add shared memory
