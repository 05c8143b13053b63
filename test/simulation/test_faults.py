# SPDX-License-Identifier: Apache-2.0
"""Camera faults over a time interval."""

import numpy as np
import pytest

from uav_vslam.simulation.faults import FAULTS, corrupted
from uav_vslam.types import NS_PER_S, StereoFrame

BEGIN_NS = 5 * NS_PER_S


def frames() -> list[StereoFrame]:
    """Return a frame each half second for ten seconds; no two images are the same."""
    rng = np.random.default_rng(1)
    return [StereoFrame(k * NS_PER_S // 2, *rng.integers(50, 200, (2, 12, 16), dtype=np.uint8)) for k in range(20)]


def with_fault(name: str) -> list[StereoFrame]:
    return list(corrupted(frames(), FAULTS[name], begin_ns=BEGIN_NS, rng=np.random.default_rng(2)))


def changed(found: list[StereoFrame]) -> list[int]:
    """Return the indices of the frames that were changed or dropped."""
    by_stamp = {frame.stamp_ns: frame for frame in found}
    return [
        k
        for k, frame in enumerate(frames())
        if frame.stamp_ns not in by_stamp
        or not np.array_equal(by_stamp[frame.stamp_ns].left, frame.left)
        or not np.array_equal(by_stamp[frame.stamp_ns].right, frame.right)
    ]


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_changes_nothing_before_and_after(name: str) -> None:
    last = BEGIN_NS + FAULTS[name].duration_s * NS_PER_S
    corrupted_stamps = [k * NS_PER_S // 2 for k in changed(with_fault(name))]
    assert corrupted_stamps
    assert all(BEGIN_NS <= stamp < last for stamp in corrupted_stamps)


def test_a_silent_camera_leaves_no_pairs_for_three_seconds() -> None:
    assert len(with_fault("one camera silent, 3 s")) == 20 - 6


def test_the_share_of_dropped_frames_is_about_as_stated() -> None:
    assert 0 < 20 - len(with_fault("30 % of the frames dropped")) < 8


def test_a_frozen_camera_repeats_its_last_good_image() -> None:
    found = with_fault("right camera frozen, 3 s")
    for k in range(10, 16):
        np.testing.assert_array_equal(found[k].right, frames()[9].right)
        np.testing.assert_array_equal(found[k].left, frames()[k].left)


def test_swapped_images_are_those_of_the_other_camera() -> None:
    found = with_fault("left and right swapped, 1 s")
    np.testing.assert_array_equal(found[10].left, frames()[10].right)
    np.testing.assert_array_equal(found[11].right, frames()[11].left)


def test_a_fault_is_repeatable() -> None:
    first, second = (with_fault("30 % of the frames dropped") for _ in range(2))
    assert [frame.stamp_ns for frame in first] == [frame.stamp_ns for frame in second]
