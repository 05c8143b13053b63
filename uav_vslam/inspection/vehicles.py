# SPDX-License-Identifier: Apache-2.0
"""Vehicles: which namespaces of a recording are those of one, and not of a driver of its sensors."""

from collections import Counter
from collections.abc import Mapping

from uav_vslam.config import InputConfig
from uav_vslam.config.input import image_names
from uav_vslam.datasets.bag import DEFAULT_VEHICLE
from uav_vslam.datasets.rosbag import TopicInfo
from uav_vslam.datasets.survey import TYPES
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.inspection.topics import guess_topics


def vehicles_of(topics: Mapping[str, TopicInfo], config: InputConfig) -> list[str]:
    """Return the namespaces that hold any of the configured topics, sorted.

    If none does, it is those that hold an IMU and the same other names of stereo pairs; else `DEFAULT_VEHICLE`.

    A namespace without images inside another one is part of that vehicle, as in /uav1/mavros/imu/data_raw; one of
    several levels is that of a driver, as in /zed/zed_node/imu/data_raw; one of an IMU alone, as in
    /mavros/imu/data_raw, is that of a pair of cameras beside it that has none. Cameras inside a namespace with the only
    IMU are that vehicle's, as in /uav1/stereo/left/image_raw.
    """
    if config.topics.left.startswith("/"):
        return [DEFAULT_VEHICLE]
    roles = _roles_by_namespace(topics, config)
    roles.pop("", None)  # topics in the root
    seeing = {name for name, held in roles.items() if held & set(SIDES)}
    above = {name: _owner(name, seeing, topics) for name in seeing}
    found, seeing = {above.get(name, name) for name in roles}, set(above.values())
    parts = {name for name in found - seeing for other in found if name.startswith(f"{other}/")}
    drivers = {name for name in found - seeing if "/" in name}
    if any({*SIDES, "imu"} & roles.get(name, set()) == set(SIDES) for name in seeing):
        drivers |= {name for name in found - seeing if roles[name] == {"imu"}}
    return sorted(found - parts - drivers) or _alike(topics) or [DEFAULT_VEHICLE]


def _roles_by_namespace(topics: Mapping[str, TopicInfo], config: InputConfig) -> dict[str, set[str]]:
    """Return the roles whose configured topics, with relative names, each namespace holds."""
    found: dict[str, set[str]] = {}
    for role in TYPES:
        for name in image_names(getattr(config.topics, role)):
            for topic in topics if name and not name.startswith("/") else ():
                if topic.endswith(f"/{name}"):
                    found.setdefault(topic.removesuffix(name).strip("/"), set()).add(role)
    return found


def _alike(topics: Mapping[str, TopicInfo]) -> list[str]:
    """Return the namespaces with an IMU in which stereo pairs have the same names as in another one, sorted."""
    split = [left.strip("/").partition("/") for left, _ in guess_topics(topics, "").stereo]
    named = {(namespace, rest) for namespace, _, rest in split if _has_imu(namespace, topics)}
    often = Counter(rest for _, rest in named)
    return sorted({namespace for namespace, rest in named if often[rest] > 1})


def _owner(cameras: str, seeing: set[str], topics: Mapping[str, TopicInfo]) -> str:
    """Return the namespace above that of cameras if it has the IMU and no other cameras; else theirs."""
    above = cameras.rpartition("/")[0]
    shared = any(other.startswith(f"{above}/") for other in seeing - {cameras})
    return above if above and not shared and _has_imu(above, topics) and not _has_imu(cameras, topics) else cameras


def _has_imu(namespace: str, topics: Mapping[str, TopicInfo]) -> bool:
    return any(topic.startswith(f"/{namespace}/") and info.msgtype in TYPES["imu"] for topic, info in topics.items())
