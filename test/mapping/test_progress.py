# SPDX-License-Identifier: Apache-2.0
from uav_vslam.mapping.progress import counted


def test_an_item_counts_when_it_has_been_used() -> None:
    done: list[str] = []
    for item in counted("abc", lambda: done.append("counted")):
        done.append(item)
    assert done == ["a", "counted", "b", "counted", "c", "counted"]
