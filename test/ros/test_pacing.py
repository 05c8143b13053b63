# SPDX-License-Identifier: Apache-2.0
"""Lock-step loses no frame and never deadlocks; tested against graphs that only answer."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import pytest

from uav_vslam.ros.answers import IMU_AHEAD, Answers, Readings
from uav_vslam.ros.pacing import EARLY_PERIOD_S, LockStep, RealTime, step_s
from uav_vslam.ros.recorded import Kind, Recorded

MS = 1_000_000
TOPICS = ("odometry", "fused/odometry")


def message(vehicle: str, kind: Kind, stamp_ms: int) -> Recorded:
    return Recorded(f"/{vehicle}/{kind.name.lower()}", vehicle, kind, stamp_ms * MS)


def flight(vehicle: str, *, frames: range, imu: range) -> list[Recorded]:
    parts = (Kind.LEFT, Kind.INFO, Kind.RIGHT)
    images = [message(vehicle, kind, stamp) for stamp in frames for kind in parts]
    return sorted(images + [message(vehicle, Kind.IMU, stamp) for stamp in imu], key=lambda m: m.stamp_ns)


def merged(*flights: list[Recorded]) -> list[Recorded]:
    return sorted((m for one in flights for m in one), key=lambda m: m.stamp_ns)


class Graph:
    """A lock-step replay whose answers are given by hand."""

    def __init__(self, recorded: list[Recorded], *, starts_ms: dict[str, int] | None = None, ins: bool = True) -> None:
        vehicles = sorted({m.vehicle for m in recorded})
        given = dict.fromkeys(vehicles, 0) if starts_ms is None else starts_ms
        self.starts = starts = {vehicle: start_ms * MS for vehicle, start_ms in given.items()}
        self.answers, self.readings = Answers(vehicles, starts, TOPICS), Readings(vehicles, starts)
        self._ins = ins
        self.time_s = 1.0
        self._order = LockStep(self.answers, self.readings, lambda: self.time_s).order(iter(recorded))
        self.published: list[Recorded] = []
        self.ended = False

    def advance(self) -> None:
        """Publish until the replay waits or ends."""
        for released in self._order:
            if released is None:
                return
            self.published.append(released)
            if self._ins and released.kind is Kind.IMU:
                self.readings.answered(released.vehicle, released.stamp_ns)
        self.ended = True

    def answer(self, vehicle: str, stamp_ms: int, topics: tuple[str, ...] = TOPICS) -> None:
        for topic in topics:
            self.answers.answered(vehicle, topic, stamp_ms * MS)
        self.advance()

    def frames(self, vehicle: str) -> list[int]:
        return [m.stamp_ns // MS for m in self.published if m.kind is Kind.LEFT and m.vehicle == vehicle]

    def newest_imu(self, vehicle: str) -> int:
        return max(m.stamp_ns // MS for m in self.published if m.kind is Kind.IMU and m.vehicle == vehicle)


def test_a_frame_waits_for_both_answers_to_the_one_before() -> None:
    graph = Graph(flight("uav1", frames=range(0, 300, 100), imu=range(0, 400, 10)))
    graph.advance()
    assert graph.frames("uav1") == [0]
    graph.answer("uav1", 0, ("odometry",))
    assert graph.frames("uav1") == [0]
    assert graph.answers.missing() == [("/uav1/fused/odometry", 0)]
    graph.answer("uav1", 0, ("fused/odometry",))
    assert graph.frames("uav1") == [0, 100]


def test_imu_samples_continue_up_to_the_next_frame() -> None:
    graph = Graph(flight("uav1", frames=range(0, 300, 100), imu=range(0, 400, 10)))
    graph.advance()
    assert graph.newest_imu("uav1") == 90


def test_the_end_waits_for_the_last_answers_then_ends() -> None:
    graph = Graph(flight("uav1", frames=range(0, 200, 100), imu=range(0, 300, 10)))
    graph.advance()
    graph.answer("uav1", 0)
    assert not graph.ended
    assert len(graph.published) == 2 * 3 + 30
    graph.answer("uav1", 100)
    assert graph.ended


def test_two_vehicles_compute_in_parallel() -> None:
    flights = [flight(name, frames=range(0, 300, 100), imu=range(0, 400, 10)) for name in ("uav1", "uav2")]
    graph = Graph(merged(*flights))
    graph.advance()
    assert graph.frames("uav1") == graph.frames("uav2") == [0]
    graph.answer("uav1", 0)
    graph.answer("uav2", 0)
    assert graph.frames("uav1") == graph.frames("uav2") == [0, 100]


def test_no_vehicle_runs_ahead_of_the_other_by_more_than_the_overlap() -> None:
    fast = flight("uav1", frames=range(0, 1000, 50), imu=range(0, 1100, 10))
    slow = flight("uav2", frames=range(0, 1000, 500), imu=range(0, 1100, 10))
    graph = Graph(merged(fast, slow))
    graph.advance()
    for stamp in range(0, 1000, 50):
        graph.answer("uav1", stamp)
    assert graph.frames("uav1") == [0, 50]
    graph.answer("uav2", 0)
    assert 100 in graph.frames("uav1")


def test_frames_before_the_start_state_are_not_waited_for() -> None:
    graph = Graph(flight("uav1", frames=range(0, 500, 100), imu=range(0, 600, 10)), starts_ms={"uav1": 200})
    graph.advance()
    assert graph.frames("uav1") == [0, 100, 200]
    assert {stamp // MS for _, stamp in graph.answers.missing()} == {200}


def test_until_the_start_state_is_known_the_front_end_paces() -> None:
    graph = Graph(flight("uav1", frames=range(0, 500, 100), imu=range(0, 600, 10)), starts_ms={}, ins=False)
    graph.advance()
    assert graph.answers.missing() == [("/uav1/stereo_features", 0)]
    graph.answer("uav1", 0, ("stereo_features",))
    assert graph.frames("uav1") == [0]  # its INS has real time to find the start
    graph.time_s += EARLY_PERIOD_S
    graph.advance()
    assert graph.answers.missing() == [("/uav1/stereo_features", 100 * MS)]
    graph.starts["uav1"] = 50 * MS
    graph.answer("uav1", 100, ("stereo_features",))
    assert {topic for topic, _ in graph.answers.missing()} == {f"/uav1/{topic}" for topic in TOPICS}


def test_half_a_stereo_pair_is_not_waited_for() -> None:
    recorded = flight("uav1", frames=range(0, 300, 100), imu=range(0, 400, 10))
    graph = Graph([m for m in recorded if (m.kind, m.stamp_ns) != (Kind.RIGHT, 0)])
    graph.advance()
    assert graph.frames("uav1") == [0, 100]


def test_a_pair_of_slightly_different_stamps_is_answered_at_the_left_ones() -> None:
    recorded = flight("uav1", frames=range(0, 300, 100), imu=range(0, 400, 10))
    late = [replace(m, stamp_ns=m.stamp_ns + MS) if m.kind is Kind.RIGHT else m for m in recorded]
    graph = Graph(merged(late))
    graph.advance()
    assert graph.frames("uav1") == [0]
    assert {stamp for _, stamp in graph.answers.missing()} == {0}
    graph.answer("uav1", 0)
    assert graph.frames("uav1") == [0, 100]


def test_a_frame_whose_stamp_goes_backwards_is_not_waited_for() -> None:
    recorded = flight("uav1", frames=range(0, 300, 100), imu=range(0, 400, 10))
    graph = Graph([*recorded, *(message("uav1", kind, 50) for kind in (Kind.LEFT, Kind.RIGHT, Kind.INFO))])
    graph.advance()
    for stamp in (0, 100, 200):
        graph.answer("uav1", stamp)
    assert graph.ended
    assert graph.frames("uav1") == [0, 100, 200, 50]


def test_in_an_imu_gap_the_sample_that_completes_a_frame_is_sent_ahead() -> None:
    readings = [*range(0, 50, 10), *range(450, 900, 10)]
    frames = flight("uav1", frames=range(0, 800, 100), imu=range(0))
    graph = Graph(merged(frames, [message("uav1", Kind.IMU, stamp) for stamp in readings]))
    graph.advance()
    graph.answer("uav1", 0)
    assert graph.frames("uav1") == [0, 100]
    assert graph.newest_imu("uav1") == 450
    for stamp in range(100, 800, 100):
        graph.answer("uav1", stamp)
    assert graph.ended
    assert graph.frames("uav1") == list(range(0, 800, 100))
    imu = [m.stamp_ns // MS for m in graph.published if m.kind is Kind.IMU]
    assert imu == readings


def test_an_imu_sample_beyond_the_look_ahead_is_not_waited_for() -> None:
    """It would take all images up to it into memory; the frames that need it go on without."""
    recorded = flight("uav1", frames=range(0, 300, 100), imu=range(0, 100, 10))
    graph = Graph([*recorded, message("uav1", Kind.OTHER, 5_000), message("uav1", Kind.IMU, 10_000)])
    graph.advance()
    graph.answer("uav1", 0)
    for _ in range(10):  # it is asked again after each frame that it gave up
        graph.advance()
    assert graph.newest_imu("uav1") == 10_000
    assert graph.frames("uav1") == [0, 100, 200]
    assert [m.stamp_ns for m in graph.published] == sorted(m.stamp_ns for m in graph.published)


def test_frames_closer_than_the_overlap_wait_for_one_another_too() -> None:
    graph = Graph(flight("uav1", frames=range(0, 200, 50), imu=range(0, 300, 10)))
    graph.advance()
    assert graph.frames("uav1") == [0]


def test_a_vehicle_whose_imu_ends_does_not_block_the_others() -> None:
    dead = flight("uav1", frames=range(0, 10_000, 100), imu=range(0, 150, 10))
    alive = flight("uav2", frames=range(0, 10_000, 100), imu=range(0, 10_100, 10))
    graph = Graph(merged(dead, alive))
    graph.advance()
    for stamp in range(0, 10_000, 100):
        graph.answer("uav1", stamp) if stamp <= 100 else None
        graph.answer("uav2", stamp)
    assert graph.ended
    assert len(graph.published) == len(dead) + len(alive)


def test_frames_after_the_last_imu_sample_are_not_waited_for() -> None:
    graph = Graph(flight("uav1", frames=range(0, 300, 100), imu=range(0, 160, 10)))
    graph.advance()
    graph.answer("uav1", 0)
    graph.answer("uav1", 100)
    assert graph.ended
    assert graph.frames("uav1") == [0, 100, 200]


def test_imu_samples_never_exceed_the_ins_s_queue() -> None:
    graph = Graph(flight("uav1", frames=range(0, 1, 100), imu=range(0, 10_000, 5)), ins=False)
    graph.advance()
    graph.answer("uav1", 0)
    imu = [m for m in graph.published if m.kind is Kind.IMU]
    assert len(imu) == IMU_AHEAD + 1  # the one at the start is never answered
    assert graph.readings.backlog() == [("uav1", 5 * MS)]
    graph.readings.answered("uav1", 500 * MS)
    graph.advance()
    assert graph.newest_imu("uav1") == 500 + 5 * IMU_AHEAD


def test_without_acknowledgements_imu_samples_are_not_paced() -> None:
    answers, readings = Answers(["uav1"], {}, ()), Readings(["uav1"], {}, None)
    recorded = flight("uav1", frames=range(0, 300, 100), imu=range(0, 10_000, 5))
    assert list(LockStep(answers, readings).order(recorded)) == recorded


def test_an_empty_recording_ends_at_once() -> None:
    graph = Graph([])
    graph.advance()
    assert graph.ended
    assert graph.published == []


def test_every_message_is_published_once_and_each_topic_keeps_its_order() -> None:
    flights = [
        flight(name, frames=range(offset, 3000, 140), imu=range(0, 3100, 10)) for name, offset in (("a", 0), ("b", 70))
    ]
    graph = Graph(merged(*flights))
    graph.advance()
    while not graph.ended:
        vehicle, stamp = graph.answers.open()[0]
        graph.answer(vehicle, stamp // MS)
    for one in flights:
        for kind in (Kind.LEFT, Kind.RIGHT, Kind.INFO, Kind.IMU):
            expected = [m for m in one if m.kind is kind]
            assert [m for m in graph.published if m.kind is kind and m.vehicle == one[0].vehicle] == expected


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_real_time_publishes_at_the_clock_s_rate(rate: float) -> None:
    now = [0.0]
    answers = Answers(["uav1"], {"uav1": 0}, TOPICS)
    recorded = flight("uav1", frames=range(0, 300, 100), imu=range(0, 400, 10))
    published: list[tuple[float, int]] = []
    for released in stepping(RealTime(answers, rate, clock=lambda: now[0]).order(recorded), now):
        published.append((now[0], released.stamp_ns))
    assert [stamp for _, stamp in published] == [m.stamp_ns for m in recorded]
    late = [at - stamp / 1e9 / rate for at, stamp in published]
    assert min(late) >= 0
    assert max(late) < 0.0011
    assert answers.frames == {"uav1": 3}


def shifted(recorded: list[Recorded], after_ms: int, jump_ms: int) -> list[Recorded]:
    return [replace(m, stamp_ns=m.stamp_ns + jump_ms * MS) if m.stamp_ns > after_ms * MS else m for m in recorded]


@pytest.mark.parametrize("jump_ms", [-60_000, -10_000, 10_000, 60_000])
def test_a_graph_that_holds_messages_until_a_jump_is_confirmed_does_not_stop_the_replay(jump_ms: int) -> None:
    """It answers nothing of the run that confirms the jump, and all later frames."""
    recorded = flight("uav1", frames=range(100_000, 104_000, 100), imu=range(100_000, 104_100, 5))
    graph = Graph(shifted(recorded, 102_000, jump_ms))
    graph.advance()
    answered = []
    while not graph.ended:
        ((vehicle, stamp_ns),) = graph.answers.open()
        answered.append(stamp_ns // MS)
        graph.answer(vehicle, stamp_ns // MS)
    assert sorted(m.stamp_ns for m in graph.published) == sorted(
        m.stamp_ns for m in shifted(recorded, 102_000, jump_ms)
    )
    lost = set(graph.frames("uav1")) - set(answered)
    assert len(lost) <= 7  # the frame before the jump, and the run
    assert all(stamp > 100_000 + min(jump_ms, 0) and stamp < 103_000 + max(jump_ms, 0) for stamp in lost)


@pytest.mark.parametrize("jump_ms", [-10_000, 60_000])
def test_in_real_time_a_jump_causes_neither_a_burst_nor_a_pause(jump_ms: int) -> None:
    now = [0.0]
    recorded = flight("uav1", frames=range(100_000, 104_000, 100), imu=range(100_000, 104_000, 10))
    answers = Answers(["uav1"], {"uav1": 0}, TOPICS)
    order = RealTime(answers, 1.0, clock=lambda: now[0]).order(shifted(recorded, 102_000, jump_ms))
    at_s = [now[0] for _ in stepping(order, now)]
    assert max(b - a for a, b in itertools.pairwise(at_s)) < 0.02
    assert at_s[-1] == pytest.approx(3.98, abs=0.05)


@pytest.mark.parametrize("ahead_ms", [0, 1000, 5000, -5000, 3_600_000])
def test_in_real_time_each_vehicle_may_have_a_clock_of_its_own(ahead_ms: int) -> None:
    now, one = [0.0], flight("uav1", frames=range(5000, 9000, 100), imu=range(5000, 9000, 10))
    other = [replace(m, vehicle="uav2", stamp_ns=m.stamp_ns + ahead_ms * MS) for m in one]
    recorded = [message for pair in zip(one, other, strict=True) for message in pair]
    answers = Answers(["uav1", "uav2"], {"uav1": 0, "uav2": 0}, TOPICS)
    at_s = [now[0] for _ in stepping(RealTime(answers, 1.0, clock=lambda: now[0]).order(recorded), now)]
    assert max(b - a for a, b in itertools.pairwise(at_s)) < 0.02
    assert at_s[-1] == pytest.approx(3.99, abs=0.05)


def stepping(order: Iterator[Recorded | None], now: list[float]) -> Iterator[Recorded]:
    for released in order:
        if released is None:
            now[0] += 0.001
        else:
            yield released


@pytest.mark.parametrize(
    ("rate", "period_s"), [(0.0, 0.005), (4.0, 0.005), (1.0, 0.005), (0.5, 0.01), (0.1, 0.05), (0.01, 0.05)]
)
def test_a_slow_replay_looks_less_often(rate: float, period_s: float) -> None:
    assert step_s(rate) == pytest.approx(period_s)
