# SPDX-License-Identifier: Apache-2.0
"""Says what is in an mcap file that is whole but not of ROS 2: the format holds messages of any kind."""

import struct
from collections.abc import Mapping
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.summary import Summary

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
    if summary is not None and (topics := named(foreign_topics(summary))):
        found.append(topics)
    return ", and ".join(found)


def is_of_ros2(channel: Channel, schema: Schema | None) -> bool:
    """Return whether a channel's messages are in CDR, of a type that is defined as ROS 2 does."""
    return channel.message_encoding == MESSAGES and (schema is None or schema.encoding in SCHEMAS)


def foreign_topics(summary: Summary) -> dict[str, str]:
    """Return the topics that are not of ROS 2, and how their messages are encoded."""
    return {
        channel.topic: channel.message_encoding
        for channel in summary.channels.values()
        if not is_of_ros2(channel, summary.schemas.get(channel.schema_id))
    }


def named(foreign: Mapping[str, str]) -> str:
    """Return what an error says of topics and their encodings; empty without any."""
    found = []
    for encoding in dict.fromkeys(foreign.values()):
        topics = sorted(topic for topic, its in foreign.items() if its == encoding)
        more = f" and {len(topics) - NAMED} more" if len(topics) > NAMED else ""
        found.append(f"messages of {', '.join(topics[:NAMED])}{more} are {encoding or 'an unknown encoding'}")
    return ", and ".join(found)
