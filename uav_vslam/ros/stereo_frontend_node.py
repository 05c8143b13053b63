# SPDX-License-Identifier: Apache-2.0
"""stereo_frontend: stereo features from image pairs.

in   left/image_raw, right/image_raw             sensor_msgs/Image, or
     left/image_raw/compressed, right/...        sensor_msgs/CompressedImage
     left/camera_info, right/camera_info         sensor_msgs/CameraInfo
     /tf_static                                  <vehicle>/base_link to both camera frames
out  stereo_features                             uav_vslam_msgs/StereoFeatures, in the left camera frame
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

from uav_vslam.config import VehicleConfig
from uav_vslam.datasets.messages import stamp_ns_of
from uav_vslam.datasets.stereo_sync import StereoPairer
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.monitor import DROPPED
from uav_vslam.ros.calibration import RigListener
from uav_vslam.ros.convert import features_to_msg, image_from_msg
from uav_vslam.ros.inputs import Input, image_topics
from uav_vslam.ros.qos import IMAGE, RESUMABLE
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam.types import NS_PER_S, StereoFrame
from uav_vslam.types import StereoFeatures as Features
from uav_vslam.vision.features import make_extractor
from uav_vslam.vision.frontend_base import Frontend
from uav_vslam.vision.frontends import make_frontend
from uav_vslam_msgs.msg import StereoFeatures

Pixels = NDArray[Any]

MAX_WAITING = 10  # pairs held until the calibration is known
MAX_ALONE = 10  # unpaired images in a row, after which one camera counts as silent
RAW_AWAITED = 5  # compressed images that are ignored if a camera offers raw ones too


class StereoFrontendNode(VehicleNode):
    """Pairs the images, runs the front end, publishes its features and reports faulty cameras."""

    def __init__(self) -> None:
        super().__init__("stereo_frontend")
        make_extractor(self.config.frontend)  # fail at start-up, not at each pair
        self._rig = RigListener(self, self._work)
        self._frontend: Frontend | None = None
        self._alone = 0  # images since the last pair
        self._image_frame = ""  # of the left images
        self._unreadable: dict[str, str] = {}  # by camera: why its newest unreadable image is
        given = self.config.input
        self._pairer: StereoPairer[Pixels] = StereoPairer(tolerance_ns=round(given.pair_tolerance_s * NS_PER_S))
        self._waiting: deque[StereoFrame] = deque()
        self._publisher = self.advertise(StereoFeatures, "stereo_features", RESUMABLE)
        self._candidates: dict[str, dict[type, Callable[[], Input]]] = {}  # by camera: opens each of its topics
        self._choices: dict[str, dict[type, Input]] = {}  # by camera: its open topics, one once it is selected
        for side in SIDES:
            topic, on_image = getattr(given.topics, side), partial(self._on_image, side)
            self._candidates[side] = {
                kind: partial(self.listen, kind, name, on_image, IMAGE, instead_of=topic)
                for kind, name in image_topics(self, topic).items()
            }
            self._choices[side] = {kind: listen() for kind, listen in self._candidates[side].items()}

    def configure(self, config: VehicleConfig) -> None:
        """Apply changed live settings."""
        if self._frontend is not None:
            self._frontend.configure(config.frontend)

    def follow_offers(self) -> None:
        """Also listen to all topics of a camera again when nobody publishes the selected one any more."""
        super().follow_offers()
        for side, choices in self._choices.items():
            if any(self.count_publishers(one.subscription.topic_name) for one in choices.values()):
                continue
            for kind, listen in self._candidates[side].items():
                if kind not in choices:
                    choices[kind] = listen()

    def reset(self) -> None:
        """Forget the tracks and the images that wait."""
        self._frontend, self._alone = None, 0
        self._waiting.clear()
        self._rig.restart()
        self._alarm({})

    def _on_image(self, side: str, message: Image | CompressedImage) -> None:
        if not self._uses(side, type(message)):
            return  # the same image once more
        if side == "left":
            self._image_frame = message.header.frame_id
        pair = self._pairer.add(side, stamp_ns_of(message), self._pixels(side, message))
        self.counts[f"{DROPPED}unpaired"] = self._pairer.dropped
        if pair is None:
            self._alone += 1
            if self._alone == MAX_ALONE:
                tolerance_ms, newest_s = self._pairer.tolerance_ns / 1e6, stamp_ns_of(message) / NS_PER_S
                self._alarm(
                    {
                        "pairs": "images arrive, but no pairs: one camera is silent, or their stamps repeat or differ "
                        f"by more than {tolerance_ms:.1f} ms (input.pair_tolerance_s); the newest is {newest_s:.3f} s"
                    }
                )
            return
        self._alone = 0
        self.counts["pairs"] += 1
        self.notes["pair_offset"] = f"{self._pairer.offset_ns / 1e6:.1f} of {self._pairer.tolerance_ns / 1e6:.1f} ms"
        self._waiting.append(StereoFrame(pair.stamp_ns + self._rig.setup.time_offset_ns, pair.left, pair.right))
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popleft()
            text = f"image pairs arrive, but {self._rig.missing}"
            self.report_alarm("calibration", text)  # until a pair is processed
            self.drop("no_calibration", text)
        self._work()

    def _uses(self, side: str, kind: type) -> bool:
        """Return whether a camera's messages of a kind are used: raw ones if published; unsubscribe from the others."""
        choices = self._choices[side]
        if len(choices) > 1:
            raw_offered = choices[Image].subscription.get_publisher_count() > 0
            if kind is CompressedImage and raw_offered and choices[kind].received <= RAW_AWAITED:
                return False
            other = choices.pop(Image if kind is CompressedImage else CompressedImage)
            self.unwatch(other)
            self.destroy_subscription(other.subscription)
        return kind in choices

    def _pixels(self, side: str, message: Image | CompressedImage) -> Pixels:
        """Return the image, empty if it can't be decoded: its frame then has no features."""
        try:
            return image_from_msg(message)
        except InvalidMessage as error:
            self._unreadable[side] = str(error)
            return np.zeros((0, 0), np.uint8)

    def _work(self) -> None:
        rig = self._rig.rig
        if rig is None:
            return
        if self._frontend is None:
            self._frontend = make_frontend(rig, self.config.frontend, self.config.rig)
            self._warn_of_lens()
        while self._waiting:
            features = self._extracted(self._frontend, self._waiting.popleft())
            frame_id = self._rig.left_frame(self._image_frame)
            self._publisher.publish(features_to_msg(features, frame_id=frame_id, size=rig.left.size))
            self.counts["features"] += len(features)

    def _warn_of_lens(self) -> None:
        if doubt := self._rig.setup.lens_doubt:
            self.notes["lens"] = doubt
            self.get_logger().warning(doubt)

    def _extracted(self, frontend: Frontend, frame: StereoFrame) -> Features:
        """Return the features of a pair, none if it is invalid: the filter then dead-reckons."""
        try:
            features = frontend.process(frame)
        except InvalidMessage as error:
            reasons = [why for side, why in self._unreadable.items() if getattr(frame, side).size == 0]
            text = "; ".join(dict.fromkeys([str(error), *reasons]))  # both cameras may have the same fault
            self.drop(error.reason, text)
            self.alarms = frontend.alarms | {error.reason: text}
            return Features.empty(frame.stamp_ns)
        self._alarm(frontend.alarms)
        return features

    def _alarm(self, alarms: dict[str, str]) -> None:
        """Report current faults: in the diagnostics while they last, in the log at their onset, and count them."""
        for subject, text in alarms.items():
            self.counts[f"alarms/{subject}"] += 1
            if subject not in self.alarms:
                self.get_logger().warning(text)
        self.alarms = dict(alarms)


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(StereoFrontendNode, args, shared_memory=True)


if __name__ == "__main__":
    raise SystemExit(main())
