# SPDX-License-Identifier: Apache-2.0
"""The folder in which ROS keeps its logs, without which it can't be initialised."""

import os
import pwd
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from uav_vslam.errors import ConfigError


@contextmanager
def log_folder() -> Iterator[None]:
    """Let ROS be initialised where HOME is unset, as in a system service.

    Raises:
        ConfigError: the logs can't be kept where ROS would keep them.
    """
    if not os.environ.get("HOME"):
        with suppress(KeyError):  # a user without an entry
            os.environ["HOME"] = pwd.getpwuid(os.getuid()).pw_dir
    try:
        yield
    except RuntimeError as error:
        if "logging" not in str(error):
            raise
        text = str(error).split(", at ")[0].removeprefix("failed to initialize logging: ")
        raise ConfigError(f"ROS can't keep its logs: {text}; name a writable folder in ROS_LOG_DIR") from None
