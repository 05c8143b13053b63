# SPDX-License-Identifier: Apache-2.0
"""A few wrong stamps are refused, a clock that was set is followed by all streams or by none; the nearest stamp."""

from itertools import chain

import pytest

from uav_vslam.stamps import IMAGE_TIME_JUMP_S, IMU_TIME_JUMP_S, RUN_LENGTH, TimeJump, TimeLine
from uav_vslam.types import NS_PER_S

STEP_NS = NS_PER_S // 5
Stamps = dict[str, list[int]]


def both(*, follow: bool = True) -> TimeLine[int]:
    streams = {"IMU": IMU_TIME_JUMP_S, "image": IMAGE_TIME_JUMP_S}
    return TimeLine(streams, apart_s=IMU_TIME_JUMP_S, reference="IMU", follow=follow)


def seconds(first: float, last: float) -> list[int]:
    """Return stamps of a stream at 5 Hz."""
    return list(range(round(first * NS_PER_S), round(last * NS_PER_S), STEP_NS))


def feed(line: TimeLine[int], stamps_ns: list[int], names: tuple[str, ...] = ("IMU", "image")) -> list[TimeJump]:
    """Feed stamps to some streams in turn; check that each item comes out once at most, and return the jumps."""
    jumps = []
    for stamp_ns, name in ((stamp_ns, name) for stamp_ns in stamps_ns for name in names):
        admitted = line.add(name, stamp_ns, stamp_ns)
        passed[name] += [item for stream, item in admitted.items if stream == name]
        for other in set(names) - {name}:
            passed[other] += [item for stream, item in admitted.items if stream == other]
        jumps += [admitted.jump] if admitted.jump else []
    return jumps


passed: Stamps = {}


@pytest.fixture(autouse=True)
def nothing_passed() -> None:
    passed.update({"IMU": [], "image": []})


@pytest.mark.parametrize("offset_s", [-3600.0, -10.0, -2.0, 10.0, 3600.0])
@pytest.mark.parametrize("count", [1, RUN_LENGTH - 1])
def test_a_few_wrong_stamps_are_refused_and_cost_nothing_else(offset_s: float, count: int) -> None:
    line, wrong = both(), [round((10.0 + offset_s) * NS_PER_S) + k * STEP_NS for k in range(count)]
    assert feed(line, seconds(0, 10)) == []
    assert feed(line, wrong, ("IMU",)) == []
    assert feed(line, seconds(10, 20)) == []
    assert passed == {"IMU": seconds(0, 20), "image": seconds(0, 20)}
    assert line.refused == {"stamp_jump": count}
    assert f"IMU stamps jump by {offset_s + 0.2:+.1f} s" in line.refusal


@pytest.mark.parametrize(("late_ns", "said"), [(300_000, "-0.3 ms"), (5_000_000, "-5 ms"), (400_000_000, "-400 ms")])
def test_a_late_reading_is_said_to_be_late_by_more_than_nothing(late_ns: int, said: str) -> None:
    line = both()
    feed(line, seconds(0, 10))
    feed(line, [seconds(0, 10)[-1] - late_ns], ("IMU",))
    feed(line, seconds(10, 11))
    assert line.refusal.startswith(f"IMU stamps jump by {said} to ")


@pytest.mark.parametrize("offset_s", [-3600.0, -10.0, -2.0, 5.2, 10.0, 3600.0])
def test_a_clock_that_was_set_is_followed_by_all_streams_and_no_item_is_lost(offset_s: float) -> None:
    line = both()
    feed(line, seconds(3600, 3610))
    (jump,) = feed(line, seconds(3610 + offset_s, 3620 + offset_s))
    expected = seconds(3600, 3610) + seconds(3610 + offset_s, 3620 + offset_s)
    assert passed == {"IMU": expected, "image": expected}
    assert jump.is_back == (offset_s < 0)
    assert jump.size_s == pytest.approx(offset_s + STEP_NS / NS_PER_S)
    assert "IMU and image" in str(jump)
    assert not line.refused
    assert line.faults == {}


@pytest.mark.parametrize("offset_s", [-3600.0, -10.0, -2.0, 10.0, 3600.0])
@pytest.mark.parametrize("begin_s", [-0.4, 0.0, 0.4, 1.0])
def test_a_stream_that_begins_as_the_clock_is_set_is_at_the_new_time(offset_s: float, begin_s: float) -> None:
    """Another process passes its stamps on at once, while those of the first are held until they confirm the jump."""
    line, at_s = TimeLine[int]({"IMU": 30.0, "image": 30.0}), 3610.0 + offset_s
    jumps = feed(line, seconds(3600, 3610), ("IMU",))
    jumps += feed(line, seconds(at_s, at_s + max(begin_s, 0.0)), ("IMU",))
    jumps += feed(line, seconds(at_s, at_s - min(begin_s, 0.0)), ("image",))
    jumps += feed(line, seconds(at_s - min(begin_s, 0.0), at_s), ("IMU",))
    jumps += feed(line, seconds(at_s + abs(begin_s), at_s + 10.0))
    assert line.faults == {}
    assert passed["IMU"][-1] == passed["image"][-1] == seconds(at_s + abs(begin_s), at_s + 10.0)[-1]
    assert len(jumps) == (abs(offset_s) > 2.0 or offset_s < 0.0) - (offset_s == 10.0)


@pytest.mark.parametrize("offset_s", [-10.0, -2.0])
def test_the_clock_of_one_stream_that_is_set_back_as_the_other_begins_is_named(offset_s: float) -> None:
    line = TimeLine[int]({"IMU": 30.0, "image": 30.0})
    feed(line, seconds(3600, 3610), ("IMU",))
    for k, stamp_ns in enumerate(seconds(3610, 3620)):
        assert not feed(line, [stamp_ns], ("image",))
        assert not feed(line, [seconds(3610 + offset_s, 3620 + offset_s)[k]], ("IMU",))
    assert list(line.faults) == ["IMU"]


def test_images_of_another_clock_from_the_beginning_are_told_with_the_difference() -> None:
    line = both()
    for stamp_ns in seconds(0, 4):
        feed(line, [stamp_ns], ("IMU",))
        feed(line, [stamp_ns + 3600 * NS_PER_S], ("image",))
    assert passed == {"IMU": seconds(0, 4), "image": []}
    assert line.faults == {
        "image": "image stamps are +3600.0 s from those of IMU: do their clocks agree, and does the computer keep up?"
    }


@pytest.mark.parametrize("name", ["IMU", "image"])
@pytest.mark.parametrize("offset_s", [-10.0, -2.0, 10.0, 3600.0])
def test_the_clock_of_one_stream_alone_is_refused_and_named_until_it_comes_back(name: str, offset_s: float) -> None:
    line, (other,) = both(), {"IMU", "image"} - {name}
    feed(line, seconds(0, 10))
    for stamp_ns in seconds(10, 14):
        assert feed(line, [stamp_ns + round(offset_s * NS_PER_S)], (name,)) == []
        assert feed(line, [stamp_ns], (other,)) == []
    assert passed[other] == seconds(0, 14)
    assert passed[name] == seconds(0, 10)
    assert list(line.faults) == [name]
    assert line.faults[name].startswith(f"{name} stamps jump by {offset_s + 0.2:+.1f} s")
    assert f"not those of {other}" in line.faults[name]
    feed(line, seconds(14, 20))
    assert passed[name] == seconds(0, 10) + seconds(14, 20)
    assert line.faults == {}


@pytest.mark.parametrize("offset_s", [-10.0, 10.0])
def test_where_jumps_are_refused_everything_is_refused_until_the_clock_is_right(offset_s: float) -> None:
    line = both(follow=False)
    feed(line, seconds(20, 30))
    assert feed(line, seconds(30 + offset_s, 34 + offset_s)) == []
    assert line.refused["stamp_jump"] == 2 * len(seconds(0, 4))
    assert sorted(line.faults) == ["IMU", "image"]
    feed(line, seconds(34, 40))
    assert passed == {"IMU": seconds(20, 30) + seconds(34, 40), "image": seconds(20, 30) + seconds(34, 40)}
    assert line.faults == {}


def test_two_publishers_of_one_stream_do_not_move_its_time_line() -> None:
    line = both()
    stray = [stamp_ns + 3600 * NS_PER_S for stamp_ns in seconds(0, 10)]
    assert feed(line, list(chain.from_iterable(zip(seconds(0, 10), stray, strict=True)))) == []
    assert passed == {"IMU": seconds(0, 10), "image": seconds(0, 10)}


def test_a_first_stamp_that_is_wrong_is_left_behind() -> None:
    line = both()
    feed(line, [3600 * NS_PER_S], ("IMU",))
    feed(line, seconds(0, 4))
    assert passed == {"IMU": [3600 * NS_PER_S, *seconds(0, 4)], "image": seconds(0, 4)}


def test_repeated_stamps_are_no_run() -> None:
    line = both()
    feed(line, seconds(0, 2))
    feed(line, [seconds(0, 2)[-1]] * 20)
    assert line.refused == {"stamp_repeated": 40}


def test_where_streams_never_go_back_older_stamps_are_repetitions() -> None:
    line: TimeLine[int] = TimeLine({"IMU": IMAGE_TIME_JUMP_S, "image": IMAGE_TIME_JUMP_S}, back=False)
    feed(line, seconds(0, 10))
    assert feed(line, seconds(5, 12)) == []
    assert passed == {"IMU": seconds(0, 12), "image": seconds(0, 12)}


def test_a_stream_that_was_silent_goes_on_where_the_others_are() -> None:
    line: TimeLine[int] = TimeLine({"IMU": IMU_TIME_JUMP_S, "image": IMU_TIME_JUMP_S}, apart_s=IMU_TIME_JUMP_S)
    feed(line, seconds(0, 10))
    feed(line, seconds(10, 20), ("IMU",))
    feed(line, seconds(20, 24))
    assert passed == {"IMU": seconds(0, 24), "image": seconds(0, 10) + seconds(20, 24)}


def test_a_stream_that_was_silent_for_long_goes_on_at_once_where_the_reference_is() -> None:
    """As images do whose driver was dead: no clock has jumped."""
    line, silent = both(), round(2 * IMAGE_TIME_JUMP_S)
    assert feed(line, seconds(0, 10)) == []
    assert feed(line, seconds(10, silent), ("IMU",)) == []
    assert feed(line, seconds(silent, silent + 1)) == []
    assert passed == {"IMU": seconds(0, silent + 1), "image": seconds(0, 10) + seconds(silent, silent + 1)}
    assert not line.refused


def test_a_keyframe_recording_loses_no_image() -> None:
    line = both()
    for at_s in range(41):
        line.add("IMU", at_s * NS_PER_S, 0)
        if at_s in (0, 8, 16, 40):
            assert line.add("image", at_s * NS_PER_S, at_s).items == [("image", at_s)]


def test_of_large_items_only_the_newest_few_are_held_and_the_others_are_counted() -> None:
    line: TimeLine[int] = TimeLine({"small": 5.0, "large": 5.0}, least=3, most={"large": 3})
    line.add("small", 0, 0)
    line.add("large", 0, 0)
    for k in range(10):
        assert not line.add("large", 60 * NS_PER_S + k * NS_PER_S, k).items
    assert line.refused["stamp_jump"] == 7
    assert not line.add("small", 60 * NS_PER_S, 0).items
    for k in range(1, 20):
        admitted = line.add("small", 60 * NS_PER_S + k * NS_PER_S // 10, k)
        if admitted.jump:
            break
    assert [item for name, item in admitted.items if name == "large"] == [7, 8, 9]
