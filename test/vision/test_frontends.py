# SPDX-License-Identifier: Apache-2.0
"""The contract of every front end, on a small rendered flight."""

import numpy as np
import pytest

from uav_vslam.config import FrontendConfig, RigConfig
from uav_vslam.errors import InvalidMessage
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.simulation.camera_render import RenderedFlight
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.types import StereoFeatures, StereoFrame
from uav_vslam.vision.frontends import FRONTENDS, make_frontend

Flown = tuple[StereoRig, list[StereoFrame]]


@pytest.fixture(scope="module")
def flight() -> Flown:
    vehicle = simulate_vehicle(Scenario(frames=3, scale=0.25, noise_sigma=1.0), 0)
    return vehicle.rig, list(RenderedFlight(vehicle))


@pytest.fixture(params=sorted(FRONTENDS))
def config(request: pytest.FixtureRequest) -> FrontendConfig:
    return FrontendConfig(method=request.param, search_scale=1.0, max_tracks=120, scale=1.0, max_matches=120)


def process(rig: StereoRig, frames: list[StereoFrame], config: FrontendConfig) -> list[StereoFeatures]:
    frontend = make_frontend(rig, config, RigConfig())
    return [frontend.process(frame) for frame in frames]


def test_processing_is_deterministic_and_does_not_modify_the_images(flight: Flown, config: FrontendConfig) -> None:
    rig, frames = flight
    before = [(frame.left.copy(), frame.right.copy()) for frame in frames]
    first, second = process(rig, frames, config), process(rig, frames, config)
    for a, b in zip(first, second, strict=True):
        assert len(a) > 20
        assert (a.pixels.tobytes(), a.descriptors.tobytes()) == (b.pixels.tobytes(), b.descriptors.tobytes())
        np.testing.assert_array_equal(a.tracks, b.tracks)
    for frame, (left, right) in zip(frames, before, strict=True):
        np.testing.assert_array_equal(frame.left, left)
        np.testing.assert_array_equal(frame.right, right)


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_uniform_images_give_no_points(flight: Flown, config: FrontendConfig, grey: int) -> None:
    rig, frames = flight
    blank = np.full_like(frames[0].left, grey)
    for features in process(rig, [StereoFrame(5, blank, blank), StereoFrame(5, frames[0].left, blank)], config):
        assert (features.stamp_ns, features.pixels.shape, features.descriptors.shape) == (5, (0, 4), (0, 128))
        assert (features.pixels.dtype, features.descriptors.dtype) == (np.float32, np.uint8)
        assert features.tracks.shape == (0,)


def test_colour_images_give_the_same_points_and_16_bit_ones_nearly(flight: Flown, config: FrontendConfig) -> None:
    rig, frames = flight
    deep = [StereoFrame(f.stamp_ns, *(image.astype(np.uint16) * 16 for image in (f.left, f.right))) for f in frames]
    colour = [StereoFrame(f.stamp_ns, *(np.dstack([image] * 3) for image in (f.left, f.right))) for f in frames]
    for a, b, c in zip(*(process(rig, images, config) for images in (frames, colour, deep)), strict=True):
        np.testing.assert_array_equal(b.pixels, a.pixels)
        assert len(c) > 0.8 * len(a)


def test_an_image_of_another_size_is_rejected_and_changes_nothing(flight: Flown, config: FrontendConfig) -> None:
    rig, frames = flight
    frontend = make_frontend(rig, config, RigConfig())
    frontend.process(frames[0])
    with pytest.raises(InvalidMessage, match="right image is") as caught:
        frontend.process(StereoFrame(frames[1].stamp_ns, frames[1].left, frames[1].right[:-1]))
    assert caught.value.reason == "image_size"
    np.testing.assert_array_equal(frontend.process(frames[1]).pixels, process(rig, frames[:2], config)[1].pixels)


def test_a_frozen_camera_is_reported_and_gives_no_points(flight: Flown, config: FrontendConfig) -> None:
    rig, frames = flight
    frontend = make_frontend(rig, config, RigConfig())
    frontend.process(frames[0])
    assert len(frontend.process(StereoFrame(frames[1].stamp_ns, frames[1].left, frames[0].right))) == 0
    assert "frozen" in frontend.alarms["right camera"]
    assert len(frontend.process(frames[2])) > 20
    assert frontend.alarms == {}


def test_without_tracks_pairs_are_processed_independently(flight: Flown) -> None:
    rig, frames = flight
    config = FrontendConfig(method="sift", scale=1.0, max_matches=120)
    alone, after_others = process(rig, frames[2:], config)[-1], process(rig, frames, config)[-1]
    assert len(alone) > 20
    assert alone.pixels.tobytes() == after_others.pixels.tobytes()
    assert alone.descriptors.tobytes() == after_others.descriptors.tobytes()
