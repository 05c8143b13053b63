# SPDX-License-Identifier: Apache-2.0
"""Opens one vehicle's flight in bags: finds its topics, calibration and start state."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import combinations
from pathlib import Path
from typing import Any

from uav_vslam.config import InputConfig
from uav_vslam.config.input import image_names
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.cdr import decode
from uav_vslam.datasets.foreign_mcap import named
from uav_vslam.datasets.frame_tree import TF, TF_STATIC, Edge, UnmovedFrames
from uav_vslam.datasets.messages import (
    TRUTH_TYPES,
    navigation_state_of,
    transforms_of,
)
from uav_vslam.datasets.rosbag import Topics, iter_readable, names_of, topics_of
from uav_vslam.datasets.sensor_setup import SensorSetup
from uav_vslam.datasets.truth import unread_text
from uav_vslam.errors import BagError, CalibrationError, InvalidMessage, UavVslamError
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.types import NS_PER_S, NavEstimate

DEFAULT_VEHICLE = "uav1"  # where topics do not begin with its name
PARTS_OVERLAP = 0.1  # at most, share of the shorter of two parts of one recording
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


def vehicles(paths: Sequence[Path], config: InputConfig | None = None) -> list[str]:
    """Return the namespaces that have left images, sorted; the default one if the topic's name is absolute."""
    left = (config or InputConfig()).topics.left
    if left.startswith("/"):
        return [DEFAULT_VEHICLE]
    endings = [f"/{name}" for name in image_names(left)]
    topics = topics_of(paths)
    found = {topic.removesuffix(end).strip("/") for topic in topics for end in endings if topic.endswith(end)}
    return sorted(found - {""})  # topics in the root are no vehicle's, unless they are named from there


def open_flight(paths: Path | Sequence[Path], vehicle: str, config: InputConfig | None = None) -> BagFlight:
    """Read what is constant during a flight: calibration, start state and topic names.

    Args:
        paths: bags that together hold the vehicle's topics.
        vehicle: its ROS namespace.
        config: its topics, frames and calibration files; the conventional ones by default.

    Raises:
        BagError: a path is missing or not a bag, or a topic is missing.
        CalibrationError: a sensor's place in the body is unknown, or the calibrations contradict each other.
    """
    bags = (paths,) if isinstance(paths, Path) else tuple(paths)
    name, config = vehicle.strip("/"), config or InputConfig()
    topics, setup = topics_of(bags), SensorSetup.of(name, config)
    left_topic, right_topic = (_image_topic(bags, topics, config.topic(name, side)) for side in SIDES)
    for side in setup.missing_infos:
        if (topic := config.topic(name, f"{side}_info")) not in topics:
            in_file = SIDES.index(side) < len(setup.files.cameras)
            remedy = (
                f"input.frames.{side}, as the files have no place of that camera" if in_file else "input.calibration"
            )
            raise _missing_topic(bags, topics, topic, f"set input.topics, or {remedy}")
    for topic in (config.topic(name, "imu"), *config.gyro_topics(name)):
        if topic not in topics:
            raise _missing_topic(bags, topics, topic)
    if (reading := _first(bags, config.topic(name, "imu"))) is not None:
        setup.imu_frame = reading.header.frame_id
    accels = [_first(bags, topic) for topic in config.gyro_topics(name)]
    if setup.needs_frames and not {TF_STATIC, TF} & topics.keys():
        raise _missing_topic(bags, topics, TF_STATIC, "set input.calibration")
    try:
        unused = _collect(bags, topics, setup)
        if TF in topics and setup.missing_transforms():
            setup.frames.borrow(unmoved_edges(bags))
        rig, T_body_imu = setup.rig(), setup.T_body_imu()
        for accel in accels:
            if accel is not None and (turned := setup.turned_accel(accel.header.frame_id)):
                raise CalibrationError(f"{turned}; unite them in the driver")
        initial_state = _initial_state(bags, setup)
    except CalibrationError as error:
        remedy = f"; input.frames.base: {setup.likely_base} is connected with all" if setup.likely_base else ""
        raise CalibrationError(f"bag {names_of(bags)}, vehicle {name}: {error}{remedy}") from None
    return BagFlight(
        paths=bags,
        vehicle=name,
        input=config,
        rig=rig,
        initial_state=initial_state,
        frame_count=topics[left_topic].count,
        left_topic=left_topic,
        right_topic=right_topic,
        T_body_imu=T_body_imu,
        time_offset_ns=setup.time_offset_ns,
        warnings=(*unused, *_warnings(bags, topics, setup)),
    )


def _warnings(bags: Sequence[Path], topics: Topics, setup: SensorSetup) -> Iterator[str]:
    """Yield what is doubtful about the frames of a recording."""
    if setup.imu_unnamed:
        topic = setup.config.topic(setup.vehicle, "imu")
        yield f"{topic} has no frame_id, so the IMU counts as the body; set input.frames.imu if it is elsewhere"
    if setup.files.unequal_clocks:
        yield setup.files.unequal_clocks
    if doubt := setup.lens_doubt:
        yield doubt
    yield from recorded_together(bags, setup.config.topic(setup.vehicle, "imu"))
    yield from setup.frames.faults
    if setup.frames.moved:
        frames = ", ".join(sorted(setup.frames.moved))
        yield f"{TF_STATIC} places {frames} differently from message to message; the last one counts"
    if topics.foreign:
        yield f"{named(topics.foreign)} instead of CDR, and are not read"
    topic = setup.config.topic(setup.vehicle, "truth")
    truth = None
    with suppress(BagError):  # `BagFlight.truth` counts what can't be read
        truth = _first(bags, topic)
    if truth is not None and truth.__msgtype__ not in TRUTH_TYPES:
        yield unread_text(topic, truth.__msgtype__)
    if conflict := setup.conflict(getattr(truth, "child_frame_id", "")):
        yield f"{topic} {conflict}"


def recorded_together(bags: Sequence[Path], topic: str) -> Iterator[str]:
    """Yield which bags hold a topic at the same time: its messages would be those of two sensors, or of two flights."""
    holding = [bag for bag in bags if topic in topics_of([bag])] if len(bags) > 1 else []
    spans = []
    for bag in holding if len(holding) > 1 else ():  # to find its last message, all of the topic is read
        if stamps_ns := [raw.stamp_ns for raw in iter_readable([bag], [topic])]:
            spans.append((bag, min(stamps_ns), max(stamps_ns)))
    for (a, begin_a, end_a), (b, begin_b, end_b) in combinations(spans, 2):
        common_ns = min(end_a, end_b) - max(begin_a, begin_b)
        if common_ns > PARTS_OVERLAP * min(end_a - begin_a, end_b - begin_b):
            yield (
                f"{a} and {b} both hold {topic} during the same {common_ns / NS_PER_S:.1f} s, and are mixed: give one "
                "flight at a time; different vehicles need topics of different names"
            )


def _image_topic(bags: Sequence[Path], topics: Topics, name: str) -> str:
    found = [topic for topic in image_names(name) if topic in topics]
    for topic in found:
        if topics[topic].msgtype in IMAGE_TYPES:
            return topic
    if found:
        raise BagError(f"bag {names_of(bags)}: {found[0]} holds {topics[found[0]].msgtype}, not {IMAGE_TYPES[0]}")
    raise _missing_topic(bags, topics, " or ".join(image_names(name)))


def _missing_topic(bags: Sequence[Path], topics: Topics, topic: str, remedy: str = "set input.topics") -> BagError:
    folder = f"/{topic.split('/')[1]}/"
    own = sorted(t for t in topics if t.startswith(folder))
    there = f"below {folder} it holds {', '.join(own)}" if own else f"it holds {', '.join(sorted(topics)) or 'nothing'}"
    if topics.foreign:
        there += f"; {named(topics.foreign)}, which can't be read"
    return BagError(f"bag {names_of(bags)} lacks {topic}; {there}; record that topic, or {remedy}")


def _initial_state(bags: Sequence[Path], setup: SensorSetup) -> NavEstimate | None:
    """Return the recorded start state; None if there is none."""
    topic = setup.config.topic(setup.vehicle, "initial_state")
    if (start := _first(bags, topic)) is None:
        return None
    if conflict := setup.conflict(start.child_frame_id):
        raise CalibrationError(f"{topic} {conflict}")
    try:
        return navigation_state_of(start)
    except InvalidMessage as error:
        raise BagError(f"bag {names_of(bags)}: {topic}: {error}; record a start state that is valid") from None


def _collect(bags: Sequence[Path], topics: Topics, setup: SensorSetup) -> list[str]:
    """Read all static transforms, and camera infos until all that is needed is known, or the recording ends.

    Returns:
        In words the camera infos that can't be used, as a driver may send them until it is calibrated.
    """
    for raw in iter_readable(bags, [TF_STATIC]) if TF_STATIC in topics else ():
        setup.frames.add(*transforms_of(decode(raw)))
    sides = {setup.config.topic(setup.vehicle, f"{side}_info"): side for side in SIDES}
    refused: dict[str, UavVslamError] = {}
    for raw in iter_readable(bags, [topic for topic in sides if topic in topics]):
        if not setup.missing_infos:
            break
        if sides[raw.topic] not in setup.cameras:
            try:
                setup.add_camera(sides[raw.topic], decode(raw))
            except (BagError, CalibrationError) as error:
                refused.setdefault(raw.topic, error)
    for side in setup.missing_infos:
        topic = setup.config.topic(setup.vehicle, f"{side}_info")
        if topic in refused:
            raise CalibrationError(f"{topic}: {refused[topic]}")
        raise BagError(f"bag {names_of(bags)} holds no message on {topic}; record it with the images")
    text = "its first message can't be used, and a later one counts"
    return [f"{topic}: {text}: {error}" for topic, error in refused.items()]


def unmoved_edges(bags: Sequence[Path]) -> list[Edge]:
    """Return the edges (parent frame, child frame, T_parent_child) of /tf that never change."""
    found = UnmovedFrames()
    for raw in iter_readable(bags, [TF]):
        with suppress(CalibrationError):  # of another frame
            found.add(transforms_of(decode(raw))[0])
    return found.edges


def _first(bags: Sequence[Path], topic: str) -> Any:
    """Return a topic's first message that can be read, None if there is no message.

    Raises:
        BagError: there are messages, but none can be read.
    """
    refused: BagError | None = None
    for raw in iter_readable(bags, [topic]):
        try:
            return decode(raw)
        except BagError as error:
            refused = refused or error
    if refused is not None:
        raise refused
    return None
