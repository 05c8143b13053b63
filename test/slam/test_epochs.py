# SPDX-License-Identifier: Apache-2.0
import pytest

from uav_vslam.slam.epochs import crosses_epoch
from uav_vslam.types import NS_PER_S


@pytest.mark.parametrize(
    ("previous_s", "now_s", "epoch_s", "crossed"),
    [
        (0.9, 1.0, 1.0, True),
        (0.9, 1.1, 1.0, True),
        (1.0, 1.1, 1.0, False),
        (1.0, 1.9, 1.0, False),
        (0.9, 3.5, 1.0, True),
        (1.2, 1.3, 0.25, True),
        (1.26, 1.3, 0.25, False),
    ],
)
def test_an_epoch_is_crossed_by_the_first_stamp_at_or_after_its_multiple(previous_s, now_s, epoch_s, crossed) -> None:
    day = 1_283_212_800 * NS_PER_S
    previous, now = (day + round(t * NS_PER_S) for t in (previous_s, now_s))
    assert crosses_epoch(previous, now, epoch_s) is crossed


def test_the_first_frame_crosses_no_epoch() -> None:
    assert not crosses_epoch(None, 5 * NS_PER_S, 1.0)
