# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags, with their messages as those of ROS 2: the same fields but for `seq` in headers and capitals' case."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

SUFFIX = ".bag"
OTHER_NAMES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def topics(file: Path) -> Iterator[tuple[str, str, int, bool]]:
    """Yield topic, type, number of messages, and whether it is latched, of each connection."""
    with ExitStack() as stack:
        for connection in stack.enter_context(Reader(file)).connections:
            latched = bool(getattr(connection.ext, "latching", 0))
            yield connection.topic, _type_of(connection), connection.msgcount, latched


def messages(
    file: Path, wanted: frozenset[str] | None, encode: Callable[[Any], bytes], store: Typestore
) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, recording stamp [ns] and CDR bytes of the messages whose type ROS 2 has, in recorded order.

    The bytes of a message that can't be read are empty: it costs itself, as in a bag of ROS 2.

    Args:
        file: the bag.
        wanted: topics; None for all.
        encode: serialises a message of ROS 2.
        store: types of ROS 2.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(Reader(file))
        chosen = [
            connection
            for connection in reader.connections
            if (wanted is None or connection.topic in wanted) and _type_of(connection) in store.types
        ]
        if not chosen:  # an empty list would mean all
            return
        types = _ros1_types((one.msgtype, one.msgdef.data) for one in chosen)
        for connection, stamp_ns, data in reader.messages(chosen):
            name = _type_of(connection)
            try:
                encoded = encode(_converted(types.deserialize_ros1(data, connection.msgtype), name, store))
            except Exception:  # rosbags' generated code raises many kinds of errors on wrong bytes
                encoded = b""
            yield connection.topic, name, stamp_ns, encoded


def _ros1_types(recorded: Iterable[tuple[str, str]]) -> Typestore:
    """Return ROS 1's types and those of (type, definition) that are not among them."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for msgtype, definition in recorded:
        if msgtype not in store.types:
            found = get_types_from_msg(definition, msgtype)
            store.register({name: fields for name, fields in found.items() if name not in store.types})
    return store


def _type_of(connection: Any) -> str:
    return OTHER_NAMES.get(connection.msgtype, connection.msgtype)


def _converted(built: Any, msgtype: str, store: Typestore) -> Any:
    """Return a message of ROS 1 as one of ROS 2, field by field."""
    fields = {}
    for name, _ in store.fielddefs[msgtype][1]:
        value = getattr(built, name) if hasattr(built, name) else getattr(built, name.upper())
        fields[name] = _converted_value(value, store)
    return store.types[msgtype](**fields)


def _converted_value(value: Any, store: Typestore) -> Any:
    if isinstance(value, np.ndarray | str | bytes | int | float):
        return value
    if isinstance(value, list):
        return [_converted_value(item, store) for item in value]
    return _converted(value, value.__msgtype__, store)
