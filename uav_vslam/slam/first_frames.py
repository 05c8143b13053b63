# SPDX-License-Identifier: Apache-2.0
"""Flies the first frames again, with what they have told of when their images were exposed.

The readout of a rolling shutter is known after some frames, by when one that was not configured has led the filter
astray. So may have an offset of the cameras' clock that was found too late to linearise the first frames about it, see
`clock_offset`. Then another flight begins at the start state and uses the same frames with what was measured; it goes
on if they fit it better.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.frame_queue import Frame
from uav_vslam.slam.slam_flight import SlamFlight, Timing
from uav_vslam.types import ImuIncrement, StereoFeatures

MOST_FRAMES = 60  # that are kept for it
MOST_TIMES = 3  # that they are flown again
READOUT, CLOCK = "the readout", "the offset of the cameras' clock"
AGAIN = "from its start state on, with the same frames and {} that was measured"


class FirstFrames:
    """The frames of a flight while it is not known when its images are exposed."""

    def __init__(self) -> None:
        self._kept: list[Frame] | None = []
        self._outputs: list[FrameOutput] = []  # of the present flight
        self._times = 0

    def __getstate__(self) -> dict[str, Any]:
        """Leave the frames out of checkpoints: what goes on from one is not flown again."""
        return self.__dict__ | {"_kept": None, "_outputs": []}

    def add(
        self,
        features: StereoFeatures,
        increment: ImuIncrement | None,
        flight: SlamFlight,
        output: FrameOutput,
        begin: Callable[[Timing], SlamFlight],
    ) -> tuple[SlamFlight, FrameOutput]:
        """Return the flight to go on with after a frame, and the output of that frame.

        Args:
            features: of the frame.
            increment: up to the frame.
            flight: has processed the frame.
            output: of the frame.
            begin: returns a flight that begins at the same start state with another timing.
        """
        if self._kept is None:
            return flight, output
        self._kept.append((features, increment))
        self._outputs.append(output)
        while self._kept is not None and (timing := flight.contradicting_timing) is not None:
            flight, output = self._flown_again(timing, flight, output, begin)
        if flight.is_timing_confirmed or len(self._outputs) >= MOST_FRAMES:
            self._forget()
        return flight, output

    def _flown_again(
        self, timing: Timing, flight: SlamFlight, output: FrameOutput, begin: Callable[[Timing], SlamFlight]
    ) -> tuple[SlamFlight, FrameOutput]:
        """Return another flight over the frames and its last output, if they fit it better; the present ones if not."""
        again = begin(timing)
        again.backend.continue_ids(flight.backend)
        outputs = [again.process(*frame) for frame in self._kept or ()]
        is_better = _fit(outputs) > _fit(self._outputs)
        self._outputs, self._times = outputs, self._times + 1
        if not is_better or self._times == MOST_TIMES:
            self._forget()
        if not is_better:
            return flight, output
        recovery = AGAIN.format(READOUT if timing.readout_s != flight.timing.readout_s else CLOCK)
        *earlier, last = outputs
        report = dataclasses.replace(last.report, recovery=recovery)
        told = (*output.warnings, f"the filter was re-initialised: {recovery}")
        warnings = (*told, *(text for one in outputs for text in one.warnings))
        return again, dataclasses.replace(last, report=report, warnings=warnings, earlier=tuple(earlier))

    def _forget(self) -> None:
        self._kept, self._outputs = None, []


def _fit(outputs: list[FrameOutput]) -> tuple[int, int]:
    """Return how well frames fit a flight: minus how many are lost, then how many points corrected the state.

    The first two don't count: where the readout is not zero, nothing is known to fit them.
    """
    reports = [output.report for output in outputs[2:]]
    lost = sum(report.coasted or report.recovery != "" for report in reports)
    return -lost, sum(report.associated for report in reports)
