# SPDX-License-Identifier: Apache-2.0
"""A message of a recording and its role in a replay. Imports no ROS."""

from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """Role of a recorded message in the pacing."""

    LEFT = "left image"
    RIGHT = "right image"
    INFO = "camera info"
    IMU = "IMU sample"
    OTHER = "other"


FRAME_PARTS = frozenset({Kind.LEFT, Kind.RIGHT, Kind.INFO})


@dataclass(frozen=True, slots=True)
class FrameShape:
    """What makes a frame of one vehicle.

    Attributes:
        parts: its messages.
        tolerance_ns: their stamps differ by no more than this [ns]; 0 for the default of `PairTolerance`.
        offset_ns: stamp of the answer minus that of the left image [ns].
    """

    parts: frozenset[Kind] = FRAME_PARTS
    tolerance_ns: int = 0
    offset_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A message of a recording.

    Attributes:
        topic: as recorded ("/uav1/imu/data_raw").
        vehicle: its namespace without slashes; "" for topics of the whole fleet.
        kind: its role in the pacing.
        stamp_ns: as `Recording.messages` has it [ns].
        payload: serialised message (CDR).
    """

    topic: str
    vehicle: str
    kind: Kind
    stamp_ns: int
    payload: bytes = b""
