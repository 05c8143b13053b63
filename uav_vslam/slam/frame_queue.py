# SPDX-License-Identifier: Apache-2.0
"""Joins what the front end saw of a frame with the motion that led to it; each comes in stamp order, at its pace."""

from collections import deque

from uav_vslam.types import ImuIncrement, StereoFeatures

MAX_WAITING = 100  # frames or increments held for their counterpart or the start; then the oldest goes
MAX_AHEAD = 10  # increments that come and wait while no features do; then the cameras are silent


class FrameQueue:
    """Frames waiting for their increment, and increments waiting for their frame.

    Attributes:
        start_ns: stamp of the start state; None until it is known, and nothing is ready before.
        before_start: frames dropped because they are older than the start state.
        lost: images whose features never came, or not in time; they are bridged by an empty frame.
        without_motion: frames dropped because no increment will ever lead to them, or because they came twice.
        motion_refused: increments dropped because they begin before the stamp that has been reached.
    """

    def __init__(self, start_ns: int | None = None) -> None:
        self.start_ns = start_ns
        self.before_start = 0
        self.lost = 0
        self.without_motion = 0
        self.motion_refused = 0
        self._reached_ns: int | None = None
        self._ahead = 0  # increments since features came last: a slow front end is behind, but not silent
        self._features: deque[StereoFeatures] = deque(maxlen=MAX_WAITING)
        self._increments: deque[ImuIncrement] = deque(maxlen=MAX_WAITING)

    def add_features(self, features: StereoFeatures) -> None:
        """Add what a frame showed."""
        if len(self._features) == MAX_WAITING:
            self._drop_oldest_frame()
        self._features.append(features)
        self._ahead = 0

    def add_increment(self, increment: ImuIncrement) -> None:
        """Add the motion between two images."""
        self._increments.append(increment)
        self._ahead += 1

    def pop(self) -> tuple[StereoFeatures, ImuIncrement | None] | None:
        """Return the next frame with the motion that led to it; None while there is none complete.

        The frame at the start state itself needs no motion. Where features stop coming, motion goes on without them.
        An increment may begin after the stamp reached, where one before it was lost, but never ends at another frame.
        """
        if self.start_ns is None:
            return None
        self._refuse_motion_from_before(self.start_ns if self._reached_ns is None else self._reached_ns)
        while self._features:
            stamp_ns = self._features[0].stamp_ns
            if stamp_ns < self.start_ns:
                self._features.popleft()
                self.before_start += 1
            elif self._reached_ns is not None and stamp_ns <= self._reached_ns:
                self._features.popleft()
                self.without_motion += 1
            elif stamp_ns == self.start_ns:
                self._reached_ns = stamp_ns
                return self._features.popleft(), None
            elif not self._increments:
                return None
            elif self._increments[0].stamp_ns > stamp_ns:  # increments come in order: none will end at this frame
                self._features.popleft()
                self.without_motion += 1
            elif self._increments[0].stamp_ns < stamp_ns:
                return self._bridge()
            else:
                increment = self._increments.popleft()
                self._reached_ns = stamp_ns
                return self._features.popleft(), increment
        waiting = len(self._increments)
        if min(self._ahead, waiting) <= MAX_AHEAD and waiting < MAX_WAITING:
            return None
        self._ahead -= 1  # one for each that comes: features that are only late may still find their motion here
        return self._bridge()

    def _bridge(self) -> tuple[StereoFeatures, ImuIncrement]:
        """Return the oldest motion with an empty frame."""
        increment = self._increments.popleft()
        self._reached_ns = increment.stamp_ns
        self.lost += 1
        return StereoFeatures.empty(increment.stamp_ns), increment

    def _refuse_motion_from_before(self, reached_ns: int) -> None:
        while self._increments and self._increments[0].start_ns < reached_ns:
            self._increments.popleft()
            self.motion_refused += 1

    def _drop_oldest_frame(self) -> None:
        self._features.popleft()
        if self.start_ns is None:
            self.before_start += 1
        else:
            self.without_motion += 1
