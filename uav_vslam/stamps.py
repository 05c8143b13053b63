# SPDX-License-Identifier: Apache-2.0
"""The time line of a node's inputs: wrong stamps refused, clocks that were set followed.

A stamp that does not continue its stream, ahead or behind, is a candidate. A few of them are errors and are refused; a
run of them that agree with each other is a clock that was set, a long silence or a recording that begins again. It is
followed only if every stream that has to be paired jumps to the same time: the clock of one sensor alone is a fault.
"""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from uav_vslam.types import NS_PER_S

T = TypeVar("T")

IMU_TIME_JUMP_S = 5.0  # a working IMU is never silent for so long
IMAGE_TIME_JUMP_S = 30.0  # recordings reduced to keyframes have gaps of many seconds
RUN_S = 0.5  # a clock that was set shows in stamps that agree for so long,
RUN_LENGTH = 5  # and in so many of them
FAULT_S = 2.0  # a stream that has left the time line alone for so long is a fault: the others should have followed
BEHIND_S = 0.5  # normal delay between streams
DISAGREEING = "do their clocks agree, and does the computer keep up?"
MAX_HELD = 2000  # of a run, then the oldest goes: 10 s of readings at 200 Hz, while slower streams follow


@dataclass(frozen=True, slots=True)
class TimeJump:
    """A jump of all streams of a time line.

    Attributes:
        streams: their names, joined.
        from_ns: newest stamp before it, of the stream that confirmed it last [ns].
        to_ns: first stamp after it, of the same stream [ns].
    """

    streams: str
    from_ns: int
    to_ns: int

    @property
    def size_s(self) -> float:
        """Signed size [s]."""
        return (self.to_ns - self.from_ns) / NS_PER_S

    @property
    def is_back(self) -> bool:
        """Whether the new stamps are not after the old ones."""
        return self.to_ns <= self.from_ns

    def __str__(self) -> str:
        or_silent = "" if self.is_back else ", or they were silent"
        size = _signed(self.to_ns - self.from_ns)
        return f"the clock of {self.streams} jumped by {size}{or_silent}, from {self.from_ns} to {self.to_ns} ns"


@dataclass(frozen=True, slots=True)
class Admitted(Generic[T]):
    """What can be processed now.

    Attributes:
        items: stream and item, in order of arrival; none while a jump is not confirmed, then the whole run.
        jump: the jump before these items; None for none.
    """

    items: list[tuple[str, T]]
    jump: TimeJump | None = None


@dataclass(slots=True)
class _Stream(Generic[T]):
    """One input.

    Attributes:
        jump_ns: largest step ahead that is no jump [ns].
        newest_ns: newest stamp on the time line; None before the first.
        first_ns: first stamp on the time line [ns].
        began, reached: arrival numbers of the first and the newest one.
        most: largest number of candidates that are kept.
        run: arrival number, stamp and item of the candidates that agree with each other.
    """

    jump_ns: int
    most: int
    newest_ns: int | None = None
    first_ns: int = 0
    began: int = 0
    reached: int = 0
    run: deque[tuple[int, int, T]] = field(default_factory=deque)

    @property
    def run_ns(self) -> int:
        """Newest stamp of the run."""
        return self.run[-1][1]

    @property
    def off_ns(self) -> int:
        """Step from the newest stamp on the time line to the run."""
        return self.run[0][1] - (self.run[0][1] if self.newest_ns is None else self.newest_ns)

    def go_on(self, stamp_ns: int, arrival: int) -> None:
        """Take a stamp on the time line."""
        if self.newest_ns is None:
            self.first_ns, self.began = stamp_ns, arrival
        self.newest_ns, self.reached = stamp_ns, arrival


class TimeLine(Generic[T]):
    """The stamps of one stream, or of several that are paired with each other.

    Attributes:
        refused: items refused, by reason.
        refusal: the last one, in words.
    """

    def __init__(
        self,
        streams: dict[str, float],
        *,
        apart_s: float = IMAGE_TIME_JUMP_S,
        reference: str = "",
        follow: bool = True,
        back: bool = True,
        least: int = RUN_LENGTH,
        most: Mapping[str, int] | None = None,
    ) -> None:
        """Begin with the first stamp of each stream.

        Args:
            streams: by name the largest step ahead that is no jump [s].
            apart_s: farthest that the newest stamps of two streams that jump together may be apart [s].
            reference: stream that the others' stamps are compared with; near them there is no step too large. Empty for
                none.
            follow: whether jumps are followed; otherwise whatever is off the time line is refused for good.
            back: whether jumps back are; otherwise older stamps are repetitions.
            least: messages that confirm a jump, besides `RUN_S`.
            most: by name how many candidates are kept, of large ones; others: `MAX_HELD`.
        """
        self._streams: dict[str, _Stream[T]] = {
            name: _Stream(round(jump_s * NS_PER_S), (most or {}).get(name, MAX_HELD))
            for name, jump_s in streams.items()
        }
        self._apart_ns, self._reference, self._follow, self._back = apart_s * NS_PER_S, reference, follow, back
        self._least, self._arrivals = least, 0
        self.refused: Counter[str] = Counter()
        self.refusal = ""

    def restart(self) -> None:
        """Forget all stamps: the next ones are on the time line."""
        for stream in self._streams.values():
            stream.newest_ns = None
            stream.run.clear()

    def add(self, name: str, stamp_ns: int, item: T) -> Admitted[T]:
        """Add the next item of a stream; return what can be processed now."""
        self._arrivals += 1
        stream = self._streams[name]
        if self._is_next(name, stamp_ns):
            self._refuse_run(name)
            stream.go_on(stamp_ns, self._arrivals)
            return Admitted([(name, item)])
        newest_ns = stream.newest_ns
        if newest_ns is not None and (stamp_ns == newest_ns or (stamp_ns < newest_ns and not self._back)):
            self._refuse("stamp_repeated", f"{name} stamp {stamp_ns} ns is not after {newest_ns} ns")
            return Admitted([])
        self._hold(name, stamp_ns, item)
        jump = self._agreed(name) if self._follow else None
        return Admitted([]) if jump is None else Admitted(self._moved(), jump)

    @property
    def faults(self) -> dict[str, str]:
        """Streams whose clock has left the time line, by name, with direction and size."""
        left_s = FAULT_S if self._follow else RUN_S
        return {name: self._off(name) for name in self._streams if self._is_confirmed(name, left_s)}

    def _is_next(self, name: str, stamp_ns: int) -> bool:
        stream, reference = self._streams[name], self._streams.get(self._reference)
        step_ns = 1 if stream.newest_ns is None else stamp_ns - stream.newest_ns
        if step_ns <= 0 or (self._is_confirmed(name) and self._is_behind(name, stamp_ns)):
            return False
        if reference is None or reference is stream or reference.newest_ns is None:
            return step_ns <= stream.jump_ns
        return abs(stamp_ns - reference.newest_ns) <= self._apart_ns  # after any silence

    def _is_behind(self, name: str, stamp_ns: int) -> bool:
        """Return whether another stream is ahead: a clock that was set back alone catches up with its own past."""
        others = (other.newest_ns for key, other in self._streams.items() if key != name)
        return any(newest_ns is not None and newest_ns - stamp_ns > BEHIND_S * NS_PER_S for newest_ns in others)

    def _hold(self, name: str, stamp_ns: int, item: T) -> None:
        stream = self._streams[name]
        if stream.run and not 0 < stamp_ns - stream.run_ns <= stream.jump_ns:
            self._refuse_run(name)
        if len(stream.run) == stream.most:
            if self._follow:
                self._refuse("stamp_jump", self._off(name))
            stream.run.popleft()
        stream.run.append((self._arrivals, stamp_ns, item))
        if not self._follow:
            self._refuse("stamp_jump", self._off(name))

    def _refuse_run(self, name: str) -> None:
        """Refuse the candidates of a stream: nothing has confirmed them."""
        stream = self._streams[name]
        if stream.run and self._follow:
            self._refuse("stamp_jump", self._off(name), len(stream.run))
        stream.run.clear()

    def _refuse(self, reason: str, text: str, count: int = 1) -> None:
        self.refused[reason] += count
        self.refusal = text

    def _is_confirmed(self, name: str, for_s: float = RUN_S) -> bool:
        run = self._streams[name].run
        return len(run) >= self._least and run[-1][1] - run[0][1] >= for_s * NS_PER_S

    def _agreed(self, name: str) -> TimeJump | None:
        """Return the jump of a stream's run if every other stream has made it, too, or is there already."""
        stream = self._streams[name]
        if not self._is_confirmed(name) or not all(self._is_at(key, stream) for key in self._streams if key != name):
            return None
        to_ns = stream.run[0][1]
        return TimeJump(" and ".join(self._streams), to_ns - stream.off_ns, to_ns)

    def _is_at(self, name: str, jumped: _Stream[T]) -> bool:
        """Return whether a stream is where another has jumped to; a stream that has not begun may be anywhere."""
        stream = self._streams[name]
        if stream.run:
            return self._is_confirmed(name) and abs(stream.run_ns - jumped.run_ns) <= self._apart_ns
        if stream.newest_ns is None:
            return True
        if abs(stream.newest_ns - jumped.run_ns) > self._apart_ns:
            return False
        return jumped.off_ns > 0 or _has_begun_after(stream, jumped)

    def _moved(self) -> list[tuple[str, T]]:
        """Go on at the new stamps, and return what was held, in order of arrival."""
        held = [(number, name, item) for name, s in self._streams.items() for number, _, item in s.run]
        for stream in self._streams.values():
            if stream.run:
                stream.go_on(stream.run_ns, self._arrivals)
            stream.run.clear()
        return [(name, item) for _, name, item in sorted(held, key=lambda entry: entry[0])]

    def _off(self, name: str) -> str:
        """Return how far a stream's run is off its time line, and which other streams are not."""
        stream = self._streams[name]
        if stream.newest_ns is None:  # never on the time line: the reference is elsewhere
            apart = _signed(stream.run_ns - (self._streams[self._reference].newest_ns or 0))
            return f"{name} stamps are {apart} from those of {self._reference}: {DISAGREEING}"
        still = [key for key in self._streams if key != name and not self._is_confirmed(key)]
        text = f"{name} stamps jump by {_signed(stream.off_ns)} to {stream.run_ns} ns"
        return f"{text}, but not those of {' and '.join(still)}: {DISAGREEING}" if still else text


def _has_begun_after(stream: _Stream[T], jumped: _Stream[T]) -> bool:
    """Return whether a stream has only been where another has jumped to: it began while that was held back."""
    if jumped.newest_ns is None or stream.began < jumped.reached:
        return False
    return abs(stream.first_ns - jumped.run[0][1]) < abs(stream.first_ns - jumped.newest_ns)


def _signed(time_ns: int) -> str:
    """Return a time in words, in a unit in which it is not zero."""
    return f"{time_ns / NS_PER_S:+.1f} s" if abs(time_ns) >= NS_PER_S else f"{time_ns / 1e6:+.4g} ms"
