# SPDX-License-Identifier: Apache-2.0
"""Camera faults, injected into the frames of a flight over a time interval."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from uav_vslam.simulation.camera_render import RenderedFlight, motion_kernel
from uav_vslam.simulation.scenario import SimulatedVehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.types import NS_PER_S, StereoFrame

FaultEffect = Callable[["FaultState", StereoFrame], StereoFrame | None]

BLUR_PX = 5.0  # along the image's vertical, the direction of image motion; five times the normal blur
FADE = 0.5  # of the brightness
DROP_SHARE = 0.3


@dataclass(slots=True)
class FaultState:
    """State of a fault during a flight.

    Attributes:
        last: the last frame before the fault.
        rng: for random faults.
    """

    last: StereoFrame | None
    rng: np.random.Generator


def _dropped(state: FaultState, frame: StereoFrame) -> StereoFrame | None:
    return None if state.rng.random() < DROP_SHARE else frame


def _silent(_: FaultState, __: StereoFrame) -> None:
    """With one camera missing there are no pairs."""
    return


def _swapped(_: FaultState, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, frame.right, frame.left)


def _black(_: FaultState, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, np.zeros_like(frame.left), np.zeros_like(frame.right))


def _blurred(_: FaultState, frame: StereoFrame) -> StereoFrame:
    kernel = motion_kernel(0.0, BLUR_PX)
    return StereoFrame(frame.stamp_ns, *(cv2.filter2D(image, -1, kernel) for image in (frame.left, frame.right)))


def _faded(_: FaultState, frame: StereoFrame) -> StereoFrame:
    faded = (cv2.convertScaleAbs(image, alpha=FADE) for image in (frame.left, frame.right))
    return StereoFrame(frame.stamp_ns, *faded)


def _frozen(state: FaultState, frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.stamp_ns, frame.left, state.last.right if state.last else frame.right)


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the cameras.

    Attributes:
        effect: turns a good frame into a corrupted one, or None if it is lost.
        duration_s: duration [s]; infinity for the rest of the flight.
    """

    effect: FaultEffect
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


def corrupted(
    frames: Iterable[StereoFrame], fault: Fault, *, begin_ns: int, rng: np.random.Generator
) -> Iterator[StereoFrame]:
    """Yield frames with a fault applied that begins at a stamp."""
    state = FaultState(None, rng)
    for frame in frames:
        if 0 <= frame.stamp_ns - begin_ns < fault.duration_s * NS_PER_S:
            bad = fault.effect(state, frame)
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
        begin_s: when it begins, relative to the first frame [s].
    """

    fault: str = ""
    begin_s: float = 0.0

    def frames(self) -> Iterable[StereoFrame]:
        """Yield the cameras' frames."""
        rendered = RenderedFlight(self.simulated)
        if not self.fault:
            return rendered
        begin_ns = int(self.simulated.frame_stamps_ns[0]) + round(self.begin_s * NS_PER_S)
        rng = np.random.default_rng([self.simulated.scenario.seed, self.simulated.index])
        return corrupted(rendered, FAULTS[self.fault], begin_ns=begin_ns, rng=rng)


def end_s(fault: str, begin_s: float, vehicle: SimulatedVehicle) -> float:
    """Return when a fault ends, relative to the first frame [s]; at the latest when the flight ends."""
    if not fault:
        return begin_s
    return min(begin_s + FAULTS[fault].duration_s, vehicle.scenario.duration_s)
