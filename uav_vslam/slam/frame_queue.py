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
    """

    def __init__(self, start_ns: int | None = None) -> None:
        self.start_ns = start_ns
        self.before_start = 0
        self.lost = 0
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
            elif stamp_ns == self.start_ns:
                return self._features.popleft(), None
            elif not self._increments or self._increments[0].stamp_ns > stamp_ns:
                return None
            elif self._increments[0].stamp_ns == stamp_ns:
                return self._features.popleft(), self._increments.popleft()
            else:
                self.lost += 1
                increment = self._increments.popleft()
                return StereoFeatures.empty(increment.stamp_ns), increment
        return None
