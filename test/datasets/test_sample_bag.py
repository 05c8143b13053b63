# SPDX-License-Identifier: Apache-2.0
"""The repository's sample recording is small, complete, and good enough for stereo matching."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from uav_vslam.datasets.bag import open_flight, vehicles
from uav_vslam.datasets.rosbag import topics_of
from uav_vslam.types import ImuSample, StereoFrame

SAMPLE = Path(__file__).parents[2] / "bags" / "sample"
LARGEST_BYTES = 5_000_000
EPIPOLAR_PX = 1.0
EXPECTED_MATCHES = 300


def test_it_is_small() -> None:
    assert sum(file.stat().st_size for file in SAMPLE.iterdir()) < LARGEST_BYTES


@pytest.mark.parametrize("vehicle", ["uav1", "uav2"])
def test_it_has_all_topics_that_a_vehicle_needs(vehicle: str) -> None:
    flight = open_flight(SAMPLE, vehicle)
    events = list(flight.iter_events())
    frames = [e for e in events if isinstance(e, StereoFrame)]
    readings = [e for e in events if isinstance(e, ImuSample)]
    truth = flight.truth()
    assert vehicles([SAMPLE]) == ["uav1", "uav2"]
    assert len(frames) == flight.frame_count == 64
    assert readings[0].stamp_ns < frames[0].stamp_ns
    assert readings[-1].stamp_ns > frames[-1].stamp_ns
    assert flight.initial_state is not None
    assert flight.initial_state.state.stamp_ns == frames[0].stamp_ns
    assert truth is not None
    assert {f.stamp_ns for f in frames} <= set(truth.stamps_ns.tolist())
    assert topics_of([SAMPLE])[f"/{vehicle}/initial_state"].latched


def test_its_images_give_stereo_points_on_the_ground() -> None:
    flight = open_flight(SAMPLE, "uav1")
    frame = [e for e in flight.iter_events() if isinstance(e, StereoFrame)][32]
    sift = cv2.SIFT_create(1000, contrastThreshold=0.01)
    left, left_descriptors = sift.detectAndCompute(frame.left, None)
    right, right_descriptors = sift.detectAndCompute(frame.right, None)
    pairs = cv2.BFMatcher().knnMatch(left_descriptors, right_descriptors, k=2)
    good = [best for best, second in pairs if best.distance < 0.8 * second.distance]
    pixels = np.array([[*left[m.queryIdx].pt, *right[m.trainIdx].pt] for m in good])
    pixels = pixels[flight.rig.epipolar_distance(pixels) < EPIPOLAR_PX]
    depth = flight.rig.triangulate(pixels)[:, 2]
    assert len(pixels) > EXPECTED_MATCHES
    assert np.nanmedian(depth) == pytest.approx(70.0, abs=4.0)
