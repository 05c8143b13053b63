# SPDX-License-Identifier: Apache-2.0
"""Says what is in an mcap file that is whole but not of ROS 2: the format holds messages of any kind."""

import struct
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

PROFILE, MESSAGES, SCHEMAS = "ros2", "cdr", ("ros2msg", "ros2idl", "")
OTHER_PROFILES = {"": "no profile", "ros1": "ROS 1's profile"}
NAMED = 3  # topics at most


def what_is_foreign(file: Path) -> str:
    """Return what makes an mcap file another than one of ROS 2; empty if nothing does, or if it can't be read."""
    try:
        with file.open("rb") as stream:
            reader = make_reader(stream)
            profile, summary = reader.get_header().profile, reader.get_summary()
    except (McapError, OSError, ValueError, struct.error):
        return ""
    found = [] if profile == PROFILE else [f"it has {OTHER_PROFILES.get(profile, f'the profile {profile!r}')}"]
    if summary is not None:
        schemas = {number: schema.encoding for number, schema in summary.schemas.items()}
        others = {
            channel.topic: channel.message_encoding or "an unknown encoding"
            for channel in summary.channels.values()
            if channel.message_encoding != MESSAGES or schemas.get(channel.schema_id, "") not in SCHEMAS
        }
        for encoding in dict.fromkeys(others.values()):
            topics = sorted(topic for topic, its in others.items() if its == encoding)
            more = f" and {len(topics) - NAMED} more" if len(topics) > NAMED else ""
            found.append(f"messages of {', '.join(topics[:NAMED])}{more} are {encoding}")
    return ", and ".join(found)
