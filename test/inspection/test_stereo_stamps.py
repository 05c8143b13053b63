# SPDX-License-Identifier: Apache-2.0
"""Images of either camera without a partner are named."""

import numpy as np
import pytest

from uav_vslam.inspection.stereo_stamps import check_pairs

EVEN_NS = np.arange(100, dtype=np.int64) * 140_000_000


@pytest.mark.parametrize(("left", "right"), [(20, 100), (100, 20)])
def test_a_camera_that_ends_early_is_named_whichever_it_is(left: int, right: int) -> None:
    (finding,) = check_pairs(EVEN_NS[:left], EVEN_NS[:right], 20, tolerance_s=0.0)
    assert finding.severity.value == ("warning" if left < right else "error")
    assert f"20 of {left} left and of {right} right images find a partner" in finding.seen


def test_a_few_images_at_the_ends_need_no_partner() -> None:
    (finding,) = check_pairs(EVEN_NS[1:], EVEN_NS[:-1], 98, tolerance_s=0.0)
    assert finding.severity.value == "ok"


@pytest.mark.parametrize("offset_s", [20.0, 1000.0, -1.7e9])
def test_cameras_of_different_clocks_are_named_and_no_tolerance_is_advised(offset_s: float) -> None:
    (finding,) = check_pairs(EVEN_NS, EVEN_NS + round(offset_s * 1e9), 0, tolerance_s=0.0)
    assert finding.severity.value == "error"
    assert "the cameras' clocks differ" in finding.remedy
    assert "pair_tolerance_s" not in finding.remedy


def test_a_trigger_with_a_constant_delay_is_still_met_with_a_tolerance() -> None:
    (finding,) = check_pairs(EVEN_NS, EVEN_NS + 40_000_000, 0, tolerance_s=0.0)
    assert "set input.pair_tolerance_s: 0.048" in finding.remedy


@pytest.mark.parametrize("stamps_ns", [0 * EVEN_NS, EVEN_NS // 1_000_000_000 * 1_000_000_000])
def test_stamps_that_repeat_are_no_lack_of_synchronisation(stamps_ns: np.ndarray) -> None:
    (finding,) = check_pairs(stamps_ns, stamps_ns, len(np.unique(stamps_ns)), tolerance_s=0.0)
    assert (finding.severity.value, finding.remedy) == ("error", "give each image a stamp of its own")
