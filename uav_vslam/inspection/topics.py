# SPDX-License-Identifier: Apache-2.0
"""Topics: which a vehicle needs and has, and which of an unknown recording's they could be."""

import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from uav_vslam.config import InputConfig
from uav_vslam.config.input import COMPRESSED, image_names
from uav_vslam.datasets.foreign_mcap import named
from uav_vslam.datasets.frame_tree import TF, TF_STATIC
from uav_vslam.datasets.rosbag import TopicInfo
from uav_vslam.datasets.survey import TYPES, Survey, topic_of
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning

WORD_PAIRS = (("left", "right"), ("Left", "Right"), ("_l", "_r"), ("front", "back"), ("front", "rear"))
NO_CAMERA = ("depth", "disparity", "mask", "label")  # images that are not a camera's
TRUTH_WORDS = ("truth", "gt", "vicon", "mocap", "optitrack", "vrpn", "leica", "prism", "rtk")
IMU_WORDS = ("raw", "imu", "data")


@dataclass(frozen=True, slots=True)
class Guess:
    """Topics that could be a vehicle's, by role, the likeliest first.

    Attributes:
        stereo: (left, right) pairs.
        others: by role.
    """

    stereo: list[tuple[str, str]]
    others: dict[str, list[str]]

    @property
    def best(self) -> dict[str, str]:
        """The likeliest topic of each role that has any."""
        chosen = dict(zip(SIDES, self.stereo[0], strict=True)) if self.stereo else {}
        return chosen | {role: names[0] for role, names in self.others.items() if names}

    def alternatives(self, role: str) -> list[str]:
        """Return the other candidates of a role."""
        if role in SIDES:
            return [pair[SIDES.index(role)] for pair in self.stereo[1:]]
        return self.others.get(role, [])[1:]


def guess_topics(recorded: Mapping[str, TopicInfo], vehicle: str) -> Guess:
    """Guess a vehicle's topics from names and types: among those in its namespace if it has images, else among all.

    Where such a namespace is that of its cameras and has no IMU, it is one that is in no other cameras' namespace.
    """
    own = {topic: info for topic, info in recorded.items() if topic.startswith(f"/{vehicle}/")}
    topics = own if _of_type(own, "left") else recorded
    images = sorted({topic.removesuffix(COMPRESSED) for topic in _of_type(topics, "left")})
    images = [topic for topic in images if not any(word in topic for word in NO_CAMERA)]
    stereo = sorted(
        _of_one_vehicle([*_stereo_pairs(images)]), key=lambda pair: ("raw" not in pair[0], len(pair[0]), pair)
    )
    left, right = stereo[0] if stereo else ("", "")
    infos = _of_type(topics, "left_info")
    seeing = {_namespace(topic) for topic in _of_type(recorded, "left")}
    imus = _of_type(topics, "imu") or [one for one in _of_type(recorded, "imu") if _namespace(one) not in seeing]
    accels = {one: accel for one in imus if (accel := one.replace("gyro", "accel")) != one and accel in imus}
    imus = [one for one in imus if one not in accels.values()]
    imus.sort(key=lambda t: (-sum(w in t for w in IMU_WORDS), -recorded[t].count, t))
    return Guess(
        stereo,
        {
            "left_info": _nearest(left, infos),
            "right_info": _nearest(right, infos),
            "imu": imus,
            "accel": [accels[one] for one in imus[:1] if one in accels],
            "initial_state": sorted(_of_type(topics, "initial_state"), key=lambda t: (topics[t].count, t)),
            "truth": [t for t in sorted(_of_type(topics, "truth")) if any(word in t.lower() for word in TRUTH_WORDS)],
        },
    )


def topics_to_set(recorded: Mapping[str, TopicInfo], guess: Guess, vehicle: str, config: InputConfig) -> dict[str, str]:
    """Return the guessed topics, by role, where nothing that can be read is under the configured names."""
    best = guess.best
    chosen = {role: topic for role, topic in best.items() if topic_of(recorded, vehicle, config, role) is None}
    if chosen.get("imu", config.topic(vehicle, "imu")) != best.get("imu"):
        chosen.pop("accel", None)  # of another IMU
    return chosen


def configuration_block(
    to_set: Mapping[str, str],
    guess: Guess,
    noise: Mapping[str, float],
    *,
    vehicle: str = "",
    frames: Mapping[str, str] | None = None,
    rectified: bool = False,
    start_method: str = "",
) -> str:
    """Return a configuration to paste, as text; empty if nothing is to be set.

    Args:
        to_set: topics by role.
        guess: other candidates, named in comments.
        noise: settings of the IMU by name ("imu.gyro_noise").
        vehicle: namespace below which topics are named, so that other vehicles are found by the same names.
        frames: values of input.frames by name ("base").
        rectified: whether to set input.rectified.
        start_method: value of start.method; empty to leave it.
    """
    lines = []
    if to_set or frames or rectified:
        lines.append("    input:")
    if rectified:
        lines.append("      rectified: true")
    if frames:
        lines += ["      frames:", *(f"        {name}: {frame}" for name, frame in frames.items())]
    if to_set:
        lines.append("      topics:")
    for role, topic in to_set.items():
        first, *more = (name.removeprefix(f"/{vehicle}/") for name in (topic, *guess.alternatives(role)))
        others = ", ".join(more)
        lines.append(f"        {role}: {first}{f'  # or {others}' if others else ''}")
    if noise:
        lines += ["    imu:", *(f"      {name.removeprefix('imu.')}: {value:g}" for name, value in noise.items())]
    if start_method:
        lines += ["    start:", f"      method: {start_method}"]
    return "\n".join(["/**:", "  ros__parameters:", *lines]) if lines else ""


def check_topics(survey: Survey, guess: Guess) -> list[Finding]:
    """Check that all topics are there, hold messages of the right type, and can be read."""
    needed = ["left", "right", "imu", *(["accel"] if survey.input.topics.accel else [])]
    needed += [f"{side}_info" for side in survey.setup.missing_infos]
    found = [finding for role in needed for finding in _check_presence(survey, role, guess)]
    for role in TYPES:
        if role not in needed and topic_of(survey.topics, survey.vehicle, survey.input, role) is None:
            name = survey.input.topic(survey.vehicle, role)
            if name in survey.topics:
                seen, allowed = f"{name} holds {survey.topics[name].msgtype}", " or ".join(TYPES[role])
                found.append(warning(f"{role} topic", seen, allowed, "it is not read: record that type"))
    if "/" in survey.vehicle:
        left = survey.input.topic(survey.vehicle, "left")
        remedy = f"for `uav-vslam run`, set input.topics.left: {left}, and so on"
        found.append(warning("namespace", f"{survey.vehicle} has several levels", "one, as results are named", remedy))
    for role, stream in survey.streams.items():
        if stream.errors:
            bad = len(stream.errors)
            read = bad + len(survey.images[role]) if role in SIDES else len(stream)  # of images a few
            judge = error if role != "truth" and bad > limits.UNUSABLE_SHARE * max(1, read) else warning
            seen = f"{stream.topic}: {bad} of {read} messages can't be used, the first: {stream.errors[0]}"
            found.append(judge(f"{role} messages", seen, "readable messages", "correct what writes them"))
    if survey.topics.foreign:
        remedy = "they are not read: record those that are needed as messages of ROS 2"
        found.append(warning("encodings", named(survey.topics.foreign), "messages in CDR", remedy))
    if survey.damage:
        found.append(warning("recording", survey.damage, "a complete bag", "only what could be read is judged"))
    return found or [ok("topics", "all that is needed is there")]


def _check_presence(survey: Survey, role: str, guess: Guess) -> list[Finding]:
    name = survey.input.topic(survey.vehicle, role)
    names = " or ".join(image_names(name)) if role in SIDES else name
    if role in survey.streams:
        if survey.topics[survey.streams[role].topic].count or survey.damage:
            return []
        return [error(f"{role} topic", f"{name} holds no message", "messages", "record the sensor")]
    present = next((one for one in image_names(name) if one in survey.topics), None)
    if present is not None:
        seen, allowed = f"{present} holds {survey.topics[present].msgtype}", " or ".join(TYPES[role])
        return [
            error(f"{role} topic", seen, allowed, f"record that type, or name another topic by input.topics.{role}")
        ]
    candidates = [one for one in (guess.best.get(role), *guess.alternatives(role)) if one]
    like = [] if candidates else sorted(_of_type(survey.topics, role))
    only = f", of its type only {', '.join(like)}" if like else ""
    other = f"record that topic, or set input.topics.{role}{': ' if candidates else ''}{' or '.join(candidates)}"
    if role.endswith("_info"):
        other += ", or give a file with input.calibration"
    return [error(f"{role} topic", f"{names} was not recorded{only}", " or ".join(TYPES[role]), other)]


def foreign(name: str, to_set: Mapping[str, str], guess: Guess) -> Finding:
    """Return the error that topics have other names than configured; the likeliest are judged instead."""
    others = guess.stereo[1:] if "left" in to_set else []
    instead = ", ".join(f"{role} {topic}" for role, topic in to_set.items())
    seen = f"nothing that can be read is on {name}; judged instead: {instead}"
    if others:
        seen += f"; also possible: {', '.join(f'{left} with {right}' for left, right in others)}"
    return error("topic names", seen, "the configured names", "put the block below into a configuration")


def other_body(name: str, base: str) -> Finding:
    """Return the error that /tf_static has no body of the configured name; the likeliest frame is the body instead."""
    seen = f"{TF_STATIC} has no {name}; judged with {base} as the body, which it connects with all sensors"
    return error("body frame", seen, "the configured name", "put the block below into a configuration")


def frames_of_images(frames: Mapping[str, str]) -> Finding:
    """Return the error that files have the lenses of cameras, by side, but no places; their images' frames serve."""
    seen = (
        f"the files have no place of the {' and '.join(frames)} camera, and no camera_info names a frame; judged with "
        f"that of the images, {' and '.join(frames.values())}"
    )
    return error("camera frames", seen, "a name", "put the block below into a configuration")


def check_frames(survey: Survey) -> list[Finding]:
    """Check that the places of all sensors are known."""
    setup, recorded = survey.setup, TF_STATIC in survey.topics
    told = f"{TF_STATIC} holds {setup.frames.held}" if recorded else f"{TF_STATIC} was not recorded"
    if setup.frames.borrowed:
        told = f"{TF_STATIC} and the still frames of {TF} hold {setup.frames.held}"
    missing = [one for one in setup.missing_transforms() if one not in setup.missing_imu_transforms()]
    if recorded and any(not setup.camera_frame(side) for side in setup.missing_infos):
        missing = []  # without camera_info the frames have no names yet
    found = []
    if missing:
        remedy = "publish it, name the frames by input.frames, or give a file with input.calibration"
        found.append(error("camera frames", told, ", ".join(missing), remedy))
    if setup.missing_imu_transforms():
        remedy = "publish it, give a file with input.calibration, or set input.frames.imu if the IMU is the body"
        seen = f"the IMU's header.frame_id is {setup.imu_frame!r}; {told}"
        found.append(error("IMU frame", seen, ", ".join(setup.missing_imu_transforms()), remedy))
    if survey.imu and setup.imu_unnamed:
        remedy = "set input.frames.imu if it is elsewhere"
        found.append(warning("IMU frame", "header.frame_id is empty, so the IMU counts as the body", "a name", remedy))
    if turned := setup.turned_accel(survey.child_frames.get("accel", "")):
        found.append(error("accelerometer frame", turned, "the gyroscope's axes", "unite them in the driver"))
    if setup.shares_frame and setup.T_left_right_of_infos is not None:
        seen = f"both cameras have {setup.camera_frame('left')}: P of camera_info places the right one"
        found.append(ok("frames", seen))
    if setup.frames.borrowed:
        seen = f"{TF} alone places {', '.join(sorted(setup.frames.borrowed))}, where they never move"
        found.append(ok("frames", seen))
    if setup.frames.moved:
        remedy = "record it again with one set of transforms, or give a file with input.calibration"
        seen = f"{', '.join(sorted(setup.frames.moved))} differently from message to message"
        found.append(warning(f"{TF_STATIC} places", seen, "one place", f"the last one is used: {remedy}"))
    for role, judge in (("initial_state", error), ("truth", warning)):
        if conflict := setup.conflict(survey.child_frames.get(role, "")):
            found.append(judge(f"{role} frame", f"it {conflict}", "the body frame", "see the text"))
    return found


def _of_type(topics: Mapping[str, TopicInfo], role: str) -> list[str]:
    return [topic for topic, info in topics.items() if info.msgtype in TYPES[role]]


def _namespace(topic: str) -> str:
    """Return the first part of a topic's name."""
    return topic.split("/")[1]


def _stereo_pairs(images: list[str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of topics that differ by a word for left and right, or by successive numbers."""
    for left, right in itertools.permutations(images, 2):
        if any(left != right and left.replace(one, other) == right for one, other in WORD_PAIRS):
            yield left, right
            continue
        if any(word in left for pair in WORD_PAIRS[:2] for word in pair):
            continue  # its partner differs by that word
        numbers = [re.split(r"(\d+)", name) for name in (left, right)]
        if len(numbers[0]) == len(numbers[1]):
            unequal = [(a, b) for a, b in zip(*numbers, strict=True) if a != b]
            if len(set(unequal)) == 1 and _successive(*unequal[0]):
                yield left, right


def _of_one_vehicle(pairs: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield the pairs in one namespace, and of two the cameras that have no partner in their own."""
    inside = [pair for pair in pairs if _namespace(pair[0]) == _namespace(pair[1])]
    paired = {topic for pair in inside for topic in pair}
    yield from (pair for pair in pairs if pair in inside or paired.isdisjoint(pair))


def _successive(one: str, other: str) -> bool:
    return one.isdigit() and other.isdigit() and int(other) == int(one) + 1


def _nearest(image: str, infos: list[str]) -> list[str]:
    """Return the camera_info topics of an image's camera: those beside it, or in the nearest folder above."""
    folder = image
    while folder.count("/") > 1:
        folder = folder.rsplit("/", 1)[0]
        beside = sorted(one for one in infos if one.rsplit("/", 1)[0] == folder)
        if beside:
            return beside
    return []
