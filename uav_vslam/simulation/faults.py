# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with cameras: made into the frames of a flight, between two times."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uav_vslam.simulation.camera_render import RenderedFlight, motion_kernel
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import NS_PER_S, StereoFrame

Spoiler = Callable[["Spoiling", StereoFrame], StereoFrame | None]

BLUR_PX = 5.0  # along the image's vertical, which is where the ground goes; five times the usual
FADE = 0.5  # of the brightness
DROP_SHARE = 0.3


@dataclass(slots=True)
class Spoiling:
    """What a fault remembers.

    Attributes:
        last: the last frame before the fault.
        rng: for what is random.
    """

    last: StereoFrame | None
    rng: np.random.Generator


def _dropped(state: Spoiling, frame: StereoFrame) -> StereoFrame | None:
    return None if state.rng.random() < DROP_SHARE else frame


def _silent(_: Spoiling, __: StereoFrame) -> None:
    """Without one camera's images there are no pairs."""
    return


def _swapped(_: Spoiling, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, frame.right, frame.left)


def _black(_: Spoiling, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, np.zeros_like(frame.left), np.zeros_like(frame.right))


def _blurred(_: Spoiling, frame: StereoFrame) -> StereoFrame:
    kernel = motion_kernel(0.0, BLUR_PX)
    return StereoFrame(frame.stamp_ns, *(cv2.filter2D(image, -1, kernel) for image in (frame.left, frame.right)))


def _faded(_: Spoiling, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, *(_scaled(image, FADE) for image in (frame.left, frame.right)))


def _frozen(state: Spoiling, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, frame.left, state.last.right if state.last else frame.right)


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the cameras.

    Attributes:
        spoil: makes a bad frame, or none, of a good one.
        duration_s: from its beginning [s]; infinity for the rest of the flight.
    """

    spoil: Spoiler
    duration_s: float


FAULTS = {
    "30 % of the frames dropped": Fault(_dropped, float("inf")),
    "one camera silent, 3 s": Fault(_silent, 3.0),
    "left and right swapped, 1 s": Fault(_swapped, 1.0),
    "black images, 3 s": Fault(_black, 3.0),
    "motion blur of 5 px": Fault(_blurred, float("inf")),
    "right camera frozen, 3 s": Fault(_frozen, 3.0),
    "half as bright, 3 s": Fault(_faded, 3.0),
}


def spoiled(
    frames: Iterable[StereoFrame], fault: Fault, *, begin_ns: int, rng: np.random.Generator
) -> Iterator[StereoFrame]:
    """Yield frames as they come through a fault that begins at a stamp."""
    state = Spoiling(None, rng)
    for frame in frames:
        if 0 <= frame.stamp_ns - begin_ns < fault.duration_s * NS_PER_S:
            bad = fault.spoil(state, frame)
            if bad is not None:
                yield bad
        else:
            state.last = frame
            yield frame


@dataclass(frozen=True, slots=True)
class FaultySource(SimulatedSource):
    """A simulated vehicle whose cameras have a fault.

    Attributes:
        fault: name in FAULTS, or "" for none.
        begin_s: when it begins, after the first frame [s].
    """

    fault: str = ""
    begin_s: float = 0.0

    def frames(self) -> Iterable[StereoFrame]:
        """Yield what the cameras give."""
        rendered = RenderedFlight(self.simulated)
        if not self.fault:
            return rendered
        begin_ns = int(self.simulated.frame_stamps_ns[0]) + round(self.begin_s * NS_PER_S)
        rng = np.random.default_rng([self.simulated.scenario.seed, self.simulated.index])
        return spoiled(rendered, FAULTS[self.fault], begin_ns=begin_ns, rng=rng)


def end_s(fault: str, begin_s: float, vehicle: SimulatedVehicle) -> float:
    """Return when a fault ends, after the first frame [s]; the end of the flight for those that last."""
    if not fault:
        return begin_s
    return min(begin_s + FAULTS[fault].duration_s, vehicle.scenario.duration_s)


def _scaled(image: NDArray[np.generic], factor: float) -> NDArray[np.generic]:
    return np.asarray(cv2.convertScaleAbs(image, alpha=factor))
