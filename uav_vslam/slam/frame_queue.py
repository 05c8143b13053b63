# SPDX-License-Identifier: Apache-2.0
"""Joins what the front end saw of a frame with the motion that led to it; each comes in stamp order, at its pace."""

from collections import deque

from uav_vslam.types import ImuIncrement, StereoFeatures

MAX_WAITING = 100  # frames or increments held for their counterpart; then the oldest goes


class FrameQueue:
    """Frames waiting for their increment, and increments waiting for their frame.

    Attributes:
        start_ns: stamp of the start state; None until it is known, and nothing is ready before.
        before_start: frames dropped because they are older than the start state.
        lost: images whose features never came; they are bridged by an empty frame.
        without_motion: frames dropped because no increment will ever lead to them, or because they came twice.
    """

    def __init__(self, start_ns: int | None = None) -> None:
        self.start_ns = start_ns
        self.before_start = 0
        self.lost = 0
        self.without_motion = 0
        self._reached_ns: int | None = None
        self._features: deque[StereoFeatures] = deque(maxlen=MAX_WAITING)
        self._increments: deque[ImuIncrement] = deque(maxlen=MAX_WAITING)

    def add_features(self, features: StereoFeatures) -> None:
        """Add what a frame showed."""
        self._features.append(features)

    def add_increment(self, increment: ImuIncrement) -> None:
        """Add the motion between two images."""
        self._increments.append(increment)

    def pop(self) -> tuple[StereoFeatures, ImuIncrement | None] | None:
        """Return the next frame with the motion that led to it; None while there is none complete.

        The frame at the start state itself needs no motion.
        """
        while self._features and self.start_ns is not None:
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
            else:
                increment = self._increments.popleft()
                self._reached_ns = increment.stamp_ns
                if increment.stamp_ns == stamp_ns:
                    return self._features.popleft(), increment
                self.lost += 1
                return StereoFeatures.empty(increment.stamp_ns), increment
        return None
