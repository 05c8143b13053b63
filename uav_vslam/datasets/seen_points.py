# SPDX-License-Identifier: Apache-2.0
"""What the images of a recording show: stereo points of some of its frames, in the world, along given poses."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from uav_vslam.config import VehicleConfig, replaced
from uav_vslam.datasets.bag_flight import BagFlight
from uav_vslam.datasets.cdr import RawMessage, decode
from uav_vslam.datasets.messages import header_stamp_ns, image_of
from uav_vslam.datasets.rosbag import UpToDamage, iter_raw
from uav_vslam.datasets.stereo_sync import StereoPair, StereoPairer
from uav_vslam.datasets.united_imu import united
from uav_vslam.errors import BagError, InvalidMessage, UavVslamError
from uav_vslam.evaluation.overlap import View
from uav_vslam.evaluation.pairing import MAX_GAP_S
from uav_vslam.evaluation.trajectory import Trajectory, interpolate
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.types import NS_PER_S, StereoFrame
from uav_vslam.vision.stereo_points import StereoFrontend

MAX_VIEWS = 200  # of a recording; at 20 m/s over 2.8 km one every 14 m, a third of an image
WIDTH_PX, SMALLEST_SCALE = 400, 0.1  # images are shrunk to this width: where points are matters, not how exactly
FEATURES = 400
MAX_POINTS = 100  # of a view: a share of them is known to 5 %


@dataclass(slots=True)
class Unread:
    """What can't be read of a recording.

    Attributes:
        damage: what broke off reading, or None.
        messages: by topic and recording stamp, why it can't be decoded.
    """

    damage: BagError | None = None
    messages: dict[tuple[str, int], str] = field(default_factory=dict)

    def add(self, raw: RawMessage, error: BagError) -> None:
        """Count a message, once."""
        self.messages.setdefault((raw.topic, raw.stamp_ns), str(error))


@dataclass(frozen=True, slots=True)
class SeenFlight:
    """What a recording shows.

    Attributes:
        pairs_ns: stamps of all image pairs, in order [ns].
        stamps_ns: of those with a pose [ns].
        views: some of these.
    """

    pairs_ns: list[int]
    stamps_ns: list[int]
    views: list[View]


def seen_flight(
    flight: BagFlight, poses: Trajectory, config: VehicleConfig, on_frame: Callable[[], None]
) -> SeenFlight:
    """Measure what at most `MAX_VIEWS` frames show, evenly over the flight; the others are not decoded.

    Args:
        flight: the recording.
        poses: of the body in the world.
        config: of the vehicle; its front end's settings for SIFT count.
        on_frame: called for each frame, measured or not.

    Raises:
        UavVslamError: fewer than two frames have a pose.
    """
    every = -(-flight.frame_count // MAX_VIEWS)
    frontend = _frontend(flight.rig, config)
    seen = SeenFlight([], [], [])
    for number, pair in enumerate(recorded_pairs(flight, Unread())):
        on_frame()
        seen.pairs_ns.append(pair.stamp_ns)
        at, found = interpolate(poses, np.array([pair.stamp_ns], np.int64), max_gap_s=MAX_GAP_S)
        if len(found) == 0:
            continue
        seen.stamps_ns.append(pair.stamp_ns)
        if number % every == 0:
            T_world_body = Pose(at.rotations[0], at.positions[0])
            seen.views.append(_view(flight, frontend, pair, T_world_body @ flight.rig.T_body_left))
    if len(seen.stamps_ns) < 2:
        raise UavVslamError(
            f"{flight.vehicle}: {len(seen.stamps_ns)} of {flight.frame_count} image pairs have a pose, too few to cut; "
            "do the stamps of images and poses agree?"
        )
    return seen


def _frontend(rig: StereoRig, config: VehicleConfig) -> StereoFrontend:
    """Return a front end that finds enough points of small images."""
    scale = max(min(config.frontend.scale, WIDTH_PX / rig.left.width), SMALLEST_SCALE)
    small = replaced(config, {"frontend.scale": scale, "frontend.max_features": FEATURES}, where="seen points")
    return StereoFrontend(rig, small.frontend, small.rig)


def readable(flight: BagFlight, topics: Sequence[str], unread: Unread) -> Iterator[tuple[int, RawMessage]]:
    """Yield stamp [ns] and message of topics, up to the damage; `unread` collects what else there is."""
    messages = UpToDamage(iter_raw(flight.paths, topics))
    for raw in united(messages, flight.input.gyro_topics(flight.vehicle)):
        try:
            stamp_ns = header_stamp_ns(raw.data)
        except BagError as error:
            unread.add(raw, error)
            continue
        yield stamp_ns, raw
    unread.damage = unread.damage or messages.error


def recorded_pairs(flight: BagFlight, unread: Unread) -> Iterator[StereoPair[RawMessage]]:
    """Yield the image pairs undecoded, with the stamps of `BagFlight.iter_events`; see `readable`."""
    pairer: StereoPairer[RawMessage] = StereoPairer(tolerance_ns=round(flight.input.pair_tolerance_s * NS_PER_S))
    for stamp_ns, raw in readable(flight, [flight.left_topic, flight.right_topic], unread):
        pair = pairer.add("left" if raw.topic == flight.left_topic else "right", stamp_ns, raw)
        if pair is not None:
            yield StereoPair(pair.stamp_ns + flight.time_offset_ns, pair.left, pair.right)


def _view(flight: BagFlight, frontend: StereoFrontend, pair: StereoPair[RawMessage], T_world_cam: Pose) -> View:
    """Return the view of a pair; images that can't be used show no points."""
    points_cam = np.zeros((0, 3))
    try:
        images = image_of(decode(pair.left)), image_of(decode(pair.right))
        features = frontend.match(frontend.detect(StereoFrame(pair.stamp_ns, *images)))
    except (BagError, InvalidMessage):
        pass
    else:
        points_cam = flight.rig.triangulate(features.pixels[:MAX_POINTS].astype(float))
        points_cam = points_cam[np.isfinite(points_cam).all(axis=1)]
    return View(pair.stamp_ns, T_world_cam, T_world_cam.apply(points_cam))
