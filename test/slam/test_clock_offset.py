# SPDX-License-Identifier: Apache-2.0
"""Cameras whose clock differs from the IMU's by tens of milliseconds."""

import numpy as np
import pytest
from fed_stage import feed

from uav_vslam.slam import clock_offset
from uav_vslam.slam.clock_offset import EVERY_S, KEPT, ClockOffsetMonitor
from uav_vslam.slam.first_frames import AGAIN, CLOCK
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.slam_flight import SlamFlight

PX = 0.05


def warnings_of(outputs: list[FrameOutput]) -> list[str]:
    return [text for output in outputs for text in output.warnings]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "late_s"), [(1, 0.01), (2, 0.02), (2, -0.015)])
def test_the_offset_is_found_in_the_first_second_and_costs_nothing(flown, seed: int, late_s: float) -> None:
    """With seed 2 no track fits a prediction by the stamps, from the second frame on."""
    flight = flown(seed, frames=60, tracked_px=PX)
    found, right = (feed(flight.tracking_stage(PX), flight.with_late_images(late)) for late in (late_s, 0.0))
    (warning,) = warnings_of(found)
    assert (
        f"{'before' if late_s > 0 else 'after'} their stamps, by the IMU's clock: add {'-' if late_s > 0 else '+'}0.0"
        in warning
    )
    estimates = [output.report.time_offset for output in found[8:]]
    assert all(abs(estimate.mean_s + late_s) < 0.003 for estimate in estimates)
    assert not any(output.report.coasted or output.report.recovery for output in found)
    assert warnings_of(right) == []
    errors, nees = flight.errors_and_nees(found)
    assert nees.mean() < 1.5
    assert errors[-1] < 2.0 * flight.errors_and_nees(right)[0][-1] + 0.2


def test_without_linearising_again_the_flight_is_lost(flown, monkeypatch: pytest.MonkeyPatch) -> None:
    """A guard of the tests above: that the offset is a state is not enough."""
    monkeypatch.setattr(ClockOffsetMonitor, "_is_far", lambda self, found: False)
    monkeypatch.setattr(ClockOffsetMonitor, "_sought", lambda self, present, config: None)
    monkeypatch.setattr(SlamFlight, "contradicting_timing", None)
    flight = flown(2, frames=60, tracked_px=PX)
    found = feed(flight.tracking_stage(PX), flight.with_late_images(0.02))
    assert any(output.report.recovery for output in found)
    assert flight.errors_and_nees(found)[1].mean() > 3.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_an_offset_that_is_found_after_a_recovery_is_used_from_the_start_on(
    flown, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """No offset that is sought explains the first frames, and the filter is re-initialised before it is known."""
    flight = flown(seed, frames=40, tracked_px=PX)
    frames = flight.with_late_images(0.03)
    outputs = feed(flight.tracking_stage(PX), frames)
    (at,) = (k for k, output in enumerate(outputs) if output.report.recovery == AGAIN.format(CLOCK))
    assert len(outputs[at].earlier) == at
    assert not any(output.report.coasted or output.report.recovery for output in outputs[at + 1 :])
    told = [text for output in outputs for text in output.warnings if "by the IMU's clock" in text]
    assert len(told) == 1
    errors, nees = flight.errors_and_nees(outputs[at:])
    assert errors[-1] < 1.5
    assert nees.mean() < 1.5
    monkeypatch.setattr(SlamFlight, "contradicting_timing", None)
    lost = feed(flight.tracking_stage(PX), frames)
    assert flight.errors_and_nees(lost)[1].mean() > 3.0


def test_a_right_clock_is_watched_for_a_second_only_and_nothing_changes(flown, monkeypatch) -> None:
    flight = flown(1, frames=24, tracked_px=PX)
    stage = flight.tracking_stage(PX)
    watched = feed(stage, flight.frames)
    assert not stage._flight._clock._past
    monkeypatch.setattr(ClockOffsetMonitor, "check", lambda self, backend, f, i, report, c: (backend, report, ""))
    for output, other in zip(watched, feed(flight.tracking_stage(PX), flight.frames), strict=True):
        np.testing.assert_array_equal(output.report.pose.T_map_body.t, other.report.pose.T_map_body.t)


@pytest.mark.slow
def test_an_offset_that_is_not_known_yet_keeps_few_frames(flown, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_offset, "KNOWN_S", 0.0)
    flight = flown(1, frames=70, tracked_px=PX)
    stage, kept = flight.tracking_stage(PX), []
    for frame in flight.frames:
        feed(stage, [frame])
        kept.append([len(one.frames) for one in stage._flight._clock._past])
    assert max(len(one) for one in kept) == KEPT
    assert max(max(one) for one in kept) * 0.14 < (KEPT + 0.5) * EVERY_S  # a frame every 0.14 s


def test_an_indefinite_filter_that_was_kept_costs_no_frame(flown) -> None:
    """After minutes with an unknown motion the information of one that is kept may be off by more than it holds."""
    flight = flown(1, frames=12, tracked_px=PX)
    stage, frames = flight.tracking_stage(PX), flight.with_late_images(0.01)
    feed(stage, frames[:1])
    kept = stage._flight._clock._past[0].backend._filter
    kept.belief = type(kept.belief)(-kept.belief.Y, kept.belief.vehicle)
    assert len(feed(stage, frames[1:])) == len(frames) - 1
