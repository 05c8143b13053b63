# SPDX-License-Identifier: Apache-2.0
"""All checks of one vehicle's recording, in order; one that can't be made does not keep the others from it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_vslam.config import VehicleConfig, replaced
from uav_vslam.datasets.bag import DEFAULT_VEHICLE, open_flight, recorded_together
from uav_vslam.datasets.calibration_files import KINDS
from uav_vslam.datasets.frame_tree import TF_STATIC
from uav_vslam.datasets.rosbag import TopicInfo, topics_of
from uav_vslam.datasets.sensor_setup import with_noise_of_files
from uav_vslam.datasets.survey import Survey, message_count, survey_flight
from uav_vslam.errors import CalibrationError, UavVslamError
from uav_vslam.geometry.stereo import SIDES, StereoRig
from uav_vslam.inspection import cameras, start, stereo_stamps, timing, topics, views
from uav_vslam.inspection.finding import Finding, Severity, count, error, ok, warning
from uav_vslam.inspection.imu import check_axes_of_truth, check_imu, readings_in_body
from uav_vslam.inspection.imu_noise import NoiseLevels, recommended
from uav_vslam.inspection.motion import check_attitude, check_scale, is_absurd, scale_of_truth
from uav_vslam.inspection.rotation import cameras_agree
from uav_vslam.inspection.stereo_stamps import OffsetHistogram
from uav_vslam.vision.tracking.frontend import MAX_GAP_S as TRACKED_GAP_S

Array = NDArray[np.float64]


@dataclass(slots=True)
class Inspection:
    """What is known of one vehicle's recording.

    Attributes:
        vehicle: name.
        findings: of all checks.
        offsets: histogram of the stereo stamps, or None.
        noise: of the IMU, by sensor; empty if there are too few readings.
        start_method: start.method to set where no start state was recorded; empty to leave it.
        block: configuration to paste; empty if nothing is to be set.
        block_of: vehicle that has to be named beside the block, whose left topic is absolute, or whose body is not that
            of others; empty for the usual one.
    """

    vehicle: str
    findings: list[Finding] = field(default_factory=list)
    offsets: OffsetHistogram | None = None
    noise: dict[str, NoiseLevels] = field(default_factory=dict)
    start_method: str = ""
    block: str = ""
    block_of: str = ""

    @property
    def usable(self) -> bool:
        """Whether the graph can run."""
        return count(self.findings, Severity.ERROR) == 0


def inspect(survey: Survey, config: VehicleConfig) -> Inspection:
    """Judge what was recorded of one vehicle, by its configuration."""
    found = Inspection(survey.vehicle)
    found.findings += topics.check_topics(survey, topics.guess_topics(survey.topics, survey.vehicle))
    _judge_stamps(survey, config, found)
    rig = _judge_cameras(survey, found)
    readings = readings_in_body(survey)
    looked = _look(survey, rig, config, found)
    scale = None if rig is None or survey.truth is None else scale_of_truth(looked.steps, survey.truth, rig)
    no_attitude = check_attitude(survey.truth, readings)
    truth = None if no_attitude or is_absurd(survey.truth, scale) else survey.truth  # by which others are judged
    imu_findings, found.noise = check_imu(replace(survey, truth=truth), readings, rig, looked, config)
    if turned := check_axes_of_truth(imu_findings):
        found.findings, truth = found.findings + turned, None
        imu_findings, found.noise = check_imu(replace(survey, truth=None), readings, rig, looked, config)
    found.findings += imu_findings + _check_clocks(survey, gyro_agrees=cameras_agree(imu_findings))
    images_ns = _stamps(survey, "left") + survey.setup.time_offset_ns
    found.findings += start.check_start(survey.initial, images_ns, readings, config, truth)
    if config.start.method == "given" and not survey.initial and readings:
        found.start_method = start.method_for(readings, images_ns, config)
    found.findings += start.check_truth(survey.truth, images_ns, recorded="truth" in survey.streams)
    found.findings += no_attitude + check_scale(scale)
    return found


def inspect_bags(
    paths: tuple[Path, ...], vehicle: str, config: VehicleConfig, on_message: Callable[[], None] = lambda: None
) -> tuple[Survey, Inspection]:
    """Read and judge one vehicle's recording; where images or IMU have other names than configured, the likeliest.

    Args:
        paths: bags that together hold its topics.
        vehicle: name.
        config: of the vehicle.
        on_message: called after each message.

    Raises:
        BagError: a path is missing or not a bag.
    """
    recorded = topics_of(paths)
    guess = topics.guess_topics(recorded, vehicle)
    to_set = topics.topics_to_set(recorded, guess, vehicle, config.input)
    foreign = _foreign(to_set)
    used = _with_noise(_with_topics(config, to_set))
    survey = survey_flight(paths, vehicle, used.input, on_message=on_message)
    if camera_frames := survey.unnamed_cameras:
        used = replaced(used, {f"input.frames.{k}": v for k, v in camera_frames.items()}, where="frames of images")
        survey.input = survey.setup.config = used.input
    base = survey.setup.likely_base
    rectified = bool(survey.setup.rectified_twice and not survey.setup.files.cameras)
    if base:
        used = replaced(used, {"input.frames.base": base}, where="guessed body")
        survey.input = survey.setup.config = used.input
    found = inspect(survey, used)
    if base:
        found.findings.insert(0, topics.other_body(config.input.base_frame(vehicle), base))
    if camera_frames:
        found.findings.insert(0, topics.frames_of_images(camera_frames))
    if foreign:
        found.findings.insert(0, topics.foreign(config.input.topic(vehicle, foreign[0]), to_set, guess))
    for text in recorded_together(paths, used.input.topic(vehicle, "imu")):
        found.findings.insert(0, warning("recordings", text, "parts of one flight", "see the text"))
    if found.usable:
        found.findings += _refused(paths, vehicle, used)
    noise = recommended(found.noise)
    frames = ({"base": base} if base else {}) | camera_frames
    found.block = topics.configuration_block(
        to_set, guess, noise, vehicle=vehicle, frames=frames, rectified=rectified, start_method=found.start_method
    )
    elsewhere = "left" in foreign and not to_set["left"].startswith(f"/{vehicle}/")
    found.block_of = vehicle if (vehicle != DEFAULT_VEHICLE if elsewhere else base) else ""
    return survey, found


def messages_to_read(recorded: Mapping[str, TopicInfo], vehicle: str, config: VehicleConfig) -> int:
    """Return how often `inspect_bags` calls `on_message`, if the recording is not damaged."""
    to_set = topics.topics_to_set(recorded, topics.guess_topics(recorded, vehicle), vehicle, config.input)
    return message_count(recorded, vehicle, _with_topics(config, to_set).input)


def _foreign(to_set: Mapping[str, str]) -> list[str]:
    """Return which of both images together, and the IMU, are not under the configured names."""
    roles = [*SIDES, "imu"] if set(SIDES) <= set(to_set) else ["imu"]
    return [role for role in roles if role in to_set]


def _with_topics(config: VehicleConfig, to_set: Mapping[str, str]) -> VehicleConfig:
    names = {f"input.topics.{role}": topic for role, topic in to_set.items()} if _foreign(to_set) else {}
    return replaced(config, names, where="guessed topics")


def _with_noise(config: VehicleConfig) -> VehicleConfig:
    try:
        return with_noise_of_files(config)
    except CalibrationError:  # the survey says so
        return config


def _refused(paths: tuple[Path, ...], vehicle: str, config: VehicleConfig) -> list[Finding]:
    """Return what the graph itself refuses, should the checks have missed it."""
    try:
        open_flight(paths, vehicle, config.input).check_images()
    except UavVslamError as refused:
        return [error("graph", str(refused), "a recording that it accepts", "see the text")]
    return []


def _judge_stamps(survey: Survey, config: VehicleConfig, found: Inspection) -> None:
    left, right, imu = (_stamps(survey, role) for role in ("left", "right", "imu"))
    for role in (*timing.SENSORS, "truth"):
        found.findings += timing.check_order(timing.NAMES[role], _stamps(survey, role))
    tracked_gap_s = TRACKED_GAP_S if config.frontend.method == "klt" else None
    for side, stamps in (("left", left), ("right", right)):
        found.findings += timing.check_image_rate(timing.NAMES[side], stamps, tracked_gap_s=tracked_gap_s)
    found.findings += timing.check_imu_rate(imu)
    found.findings += timing.check_coverage(imu, left + survey.setup.time_offset_ns)
    found.offsets = stereo_stamps.histogram(left, right)
    tolerance_s = survey.input.pair_tolerance_s
    found.findings += stereo_stamps.check_pairs(left, right, survey.pair_count, tolerance_s=tolerance_s)


def _check_clocks(survey: Survey, *, gyro_agrees: bool) -> list[Finding]:
    offset_ns = survey.setup.time_offset_ns
    clocks = timing.check_clocks(survey.streams, offset_ns, gyro_agrees=gyro_agrees)
    if timing.recorded_late_ms(survey.streams, offset_ns) or count(clocks, Severity.ERROR):
        return clocks  # messages of another clock are all late
    return clocks + timing.check_lateness(survey.streams, offset_ns)


def _judge_cameras(survey: Survey, found: Inspection) -> StereoRig | None:
    """Judge calibration and images; return the rig if there is one."""
    if text := survey.setup.files.unequal_clocks:
        found.findings.append(warning("clocks of the cameras", text, "one clock", "see the text"))
    if text := survey.setup.lens_doubt:
        found.findings.append(warning("rectified images", text, "images as they were calibrated", "see the text"))
    for text in survey.setup.frames.faults:
        found.findings.append(warning("frames", text, "unit quaternions, finite places", "it is left out"))
    for text in dict.fromkeys(survey.problems):
        if text.startswith(TF_STATIC):
            found.findings.append(error("frames", text, "tf2_msgs/msg/TFMessage", "record it again"))
        else:
            found.findings.append(error("calibration files", text, f"files of {KINDS}", "correct or replace the file"))
    found.findings += topics.check_frames(survey)
    for index, side in enumerate(SIDES):
        try:
            camera = survey.setup.camera(index)
        except CalibrationError:  # check_topics says so
            camera = None
        if camera is not None:
            found.findings += cameras.check_camera(f"{side} camera", camera)
        repeated = survey.repeated.get(side, np.zeros(0, bool))
        found.findings += cameras.check_images(side, survey.images[side], repeated, camera)
    try:
        rig = survey.setup.rig()
    except CalibrationError as refused:
        if not survey.setup.missing_infos and not survey.setup.missing_transforms():
            found.findings.append(error("rig", str(refused), "two cameras apart, of one size", cameras.CALIBRATE))
        return None
    found.findings += cameras.check_rig(rig)
    found.findings += cameras.check_baseline_of_infos(rig, survey.setup.T_left_right_of_infos)
    return rig


def _look(survey: Survey, rig: StereoRig | None, config: VehicleConfig, found: Inspection) -> views.Views:
    """Judge the geometry of sampled pairs, unless calibration or images are wrong already."""
    blind = [one for one in found.findings if one.severity is Severity.ERROR and " image" in one.subject]
    if rig is None or not survey.samples or blind:
        found.findings.append(ok("stereo geometry", "not judged: no pairs of sound images with a calibration"))
        return views.Views(np.zeros((0, 4)), [], np.zeros((0, 2)))
    looked = views.look(survey.samples, rig, config.frontend)
    found.findings += views.check_geometry(looked.pixels, rig, config.frontend) + views.check_flow(looked.flow_px)
    return looked


def _stamps(survey: Survey, role: str) -> NDArray[np.int64]:
    return survey.streams[role].stamps_ns if role in survey.streams else np.zeros(0, np.int64)
