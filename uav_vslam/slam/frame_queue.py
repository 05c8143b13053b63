# SPDX-License-Identifier: Apache-2.0
"""Pairs each frame's features with the IMU increment up to it; each stream is in stamp order."""

from collections import deque

from uav_vslam.types import ImuIncrement, StereoFeatures

Frame = tuple[StereoFeatures, ImuIncrement | None]  # motion since the one before: none at the start, or if lost

MAX_WAITING = 100  # frames or increments waiting for their counterpart or the start; then the oldest is dropped
MAX_AHEAD = 10  # increments that arrive and wait without any features; then the cameras count as silent
MOST_UNPAIRED = 20  # that are counted, so that some paired frames show that all is well again


class FrameQueue:
    """Frames waiting for their increment, and increments waiting for their frame.

    Attributes:
        start_ns: stamp of the start state; None until it is known, and nothing is ready before.
        before_start: frames dropped because they are older than the start state.
        before_rig: frames dropped because too many waited for the calibration.
        lost: images whose features did not arrive in time; replaced by an empty frame.
        without_motion: frames dropped because they are inside an increment, or because they are repeated.
        motion_before_start, motion_before_rig: increments dropped because too many waited for start or calibration.
        motion_refused: increments dropped because they begin before the stamp reached.
        unpaired: recent frames dropped because no increment ends at their stamp; each paired one offsets two.
        apart_ns: of the last of those, its stamp minus that of the nearest end of an increment [ns].
    """

    def __init__(self) -> None:
        self.start_ns: int | None = None
        self.before_start = 0
        self.before_rig = 0
        self.lost = 0
        self.without_motion = 0
        self.motion_before_start = 0
        self.motion_before_rig = 0
        self.motion_refused = 0
        self.unpaired = 0
        self.apart_ns = 0
        self._reached_ns: int | None = None
        self._ahead = 0  # increments since the last features: a slow front end lags, but is not silent
        self._features: deque[StereoFeatures] = deque(maxlen=MAX_WAITING)
        self._increments: deque[ImuIncrement] = deque(maxlen=MAX_WAITING)

    def add_features(self, features: StereoFeatures, *, has_rig: bool = True) -> None:
        """Add a frame's features; without the calibration no frame is taken from the queue."""
        if len(self._features) == MAX_WAITING:
            self._drop_oldest_frame(has_rig=has_rig)
        self._features.append(features)
        self._ahead = 0

    def add_increment(self, increment: ImuIncrement, *, has_rig: bool = True) -> None:
        """Add the motion between two images; without the calibration none is taken from the queue."""
        if len(self._increments) == MAX_WAITING:  # only while nothing is taken
            self.motion_before_rig += not has_rig
            self.motion_before_start += has_rig
        self._increments.append(increment)
        self._ahead += 1

    def pop(self) -> Frame | None:
        """Return the next frame with the increment up to it; None while none is complete.

        A frame has none at the start state itself, and where increments were lost. Without features, motion continues
        with empty frames. An increment may begin after the stamp reached, but always ends at its frame.
        """
        if self.start_ns is None:
            return None
        self._refuse_motion_before(self.start_ns if self._reached_ns is None else self._reached_ns)
        self._drop_frames_without_motion(self.start_ns)
        if not self._features:
            return self._bridge_silence()
        stamp_ns = self._features[0].stamp_ns
        if stamp_ns == self.start_ns or self._is_motion_lost(stamp_ns):
            self._reached_ns = stamp_ns
            return self._features.popleft(), None
        if not self._increments:
            return None
        if self._increments[0].stamp_ns < stamp_ns:
            return self._bridge()
        self._reached_ns = stamp_ns
        self.unpaired = max(0, self.unpaired - 2)
        return self._features.popleft(), self._increments.popleft()

    def _is_motion_lost(self, stamp_ns: int) -> bool:
        """Return whether a frame's increment was lost: the next one begins at its stamp or later."""
        return self._reached_ns is not None and bool(self._increments) and stamp_ns <= self._increments[0].start_ns

    def _bridge_silence(self) -> Frame | None:
        """Return the oldest increment with an empty frame, if the cameras count as silent; None if not."""
        waiting = len(self._increments)
        if min(self._ahead, waiting) <= MAX_AHEAD and waiting < MAX_WAITING:
            return None
        self._ahead -= 1  # one per arrival: features that are merely late may still be paired
        return self._bridge()

    def _bridge(self) -> Frame:
        """Return the oldest increment with an empty frame."""
        increment = self._increments.popleft()
        self._reached_ns = increment.stamp_ns
        self.lost += 1
        return StereoFeatures.empty(increment.stamp_ns), increment

    def _drop_frames_without_motion(self, start_ns: int) -> None:
        """Drop the oldest frames as long as no increment will end at them."""
        while self._features:
            stamp_ns = self._features[0].stamp_ns
            if stamp_ns < start_ns:
                self._features.popleft()
                self.before_start += 1
            elif self._reached_ns is not None and stamp_ns <= self._reached_ns:
                self._features.popleft()
                self.without_motion += 1
            elif stamp_ns != start_ns and self._is_inside_increment(stamp_ns):
                self._drop_unpaired(self._increments[0])
            else:
                return

    def _is_inside_increment(self, stamp_ns: int) -> bool:
        """Return whether the next increment ends after a frame; increments are in order, so none will end at it."""
        return bool(self._increments) and self._increments[0].stamp_ns > stamp_ns and not self._is_motion_lost(stamp_ns)

    def _drop_unpaired(self, increment: ImuIncrement) -> None:
        """Drop the oldest frame, whose stamp is inside an increment."""
        stamp_ns = self._features.popleft().stamp_ns
        self.apart_ns = min(stamp_ns - increment.start_ns, stamp_ns - increment.stamp_ns, key=abs)
        self.unpaired = min(self.unpaired + 1, MOST_UNPAIRED)
        self.without_motion += 1

    def _refuse_motion_before(self, reached_ns: int) -> None:
        while self._increments and self._increments[0].start_ns < reached_ns:
            self._increments.popleft()
            self.motion_refused += 1

    def _drop_oldest_frame(self, *, has_rig: bool) -> None:
        self._features.popleft()
        if not has_rig:
            self.before_rig += 1
        elif self.start_ns is None:
            self.before_start += 1
        else:
            self.without_motion += 1
