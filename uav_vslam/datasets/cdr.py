# SPDX-License-Identifier: Apache-2.0
"""Messages as CDR bytes: their types, and how they are built, encoded and decoded."""

import os
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from uav_vslam.errors import BagError

MESSAGE_PACKAGE = "uav_vslam_msgs"


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it was recorded; one of ROS 1 as ROS 2 has it.

    Attributes:
        topic, msgtype: name and type.
        stamp_ns: when it was recorded [ns].
        data: CDR bytes.
        definition: of its type, as recorded; empty if it was not.
    """

    topic: str
    msgtype: str
    stamp_ns: int
    data: bytes
    definition: str = field(default="", compare=False)  # texts of the same type differ in comments


@cache
def typestore() -> Typestore:
    """Return Jazzy's message types and our own, if their definitions are found."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in sorted(_message_folder().glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"{MESSAGE_PACKAGE}/msg/{path.stem}"))
    store.register(types)
    return store


def message(msgtype: str, **fields: Any) -> Any:
    """Build a message; `fields` must be all of its fields.

    Raises:
        BagError: the type is not known.
    """
    require_type(msgtype)
    return typestore().types[msgtype](**fields)


def encode(built: Any) -> bytes:
    """Return the CDR bytes of a message made by `message`."""
    return bytes(encoded_view(built))


def encoded_view(built: Any) -> memoryview:
    """Return the CDR bytes of a message made by `message` without a copy, to be written at once."""
    return typestore().serialize_cdr(built, built.__msgtype__)


@cache
def definition(msgtype: str) -> tuple[str, str]:
    """Return text and hash of a type's definition, which take milliseconds to make."""
    text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
    return text, typestore().hash_rihs01(msgtype)


def decode(raw: RawMessage) -> Any:
    """Return the message object of recorded bytes.

    Raises:
        BagError: the type is not known or the bytes do not fit it.
    """
    types = _types_of(raw.msgtype, raw.definition)
    if types is typestore():
        require_type(raw.msgtype)
    try:
        return types.deserialize_cdr(raw.data, raw.msgtype)
    except Exception as error:  # rosbags' generated code raises many kinds of errors on wrong bytes
        raise BagError(f"{raw.topic} at {raw.stamp_ns} ns: not a valid {raw.msgtype} ({error})") from None


@cache
def _types_of(msgtype: str, recorded: str) -> Typestore:
    """Return the present types; for one of ours that a bag defines otherwise, as an older version did, the bag's."""
    if not msgtype.startswith(MESSAGE_PACKAGE) or not recorded:
        return typestore()
    if msgtype in typestore().types and recorded == definition(msgtype)[0]:
        return typestore()
    store = get_typestore(Stores.ROS2_JAZZY)
    try:
        found = get_types_from_msg(recorded, msgtype)
    except TypesysError:
        return typestore()
    store.register({name: fields for name, fields in found.items() if name.startswith(MESSAGE_PACKAGE)})
    return store


def _message_folder() -> Path:
    """Return the folder of our .msg files: beside the sources, or where colcon or pip installed them."""
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates = [Path(__file__).resolve().parents[2] / MESSAGE_PACKAGE / "msg"]
    candidates += [prefix / "share" / MESSAGE_PACKAGE / "msg" for prefix in [*prefixes, Path(sys.prefix)]]
    return next((folder for folder in candidates if folder.is_dir()), candidates[0])


def require_type(msgtype: str) -> None:
    """Check that a message type is known.

    Raises:
        BagError: it is not.
    """
    if msgtype not in typestore().types:
        hint = "build it and source its workspace" if msgtype.startswith(MESSAGE_PACKAGE) else "use a Jazzy type"
        raise BagError(f"message type {msgtype} is not known; {hint} (searched {_message_folder()})")
