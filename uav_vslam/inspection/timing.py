# SPDX-License-Identifier: Apache-2.0
"""Stamps of the streams: order, rate, gaps, clocks, and whether the IMU covers the images."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from uav_vslam.datasets.bag_flight import REORDER_NS
from uav_vslam.datasets.survey import Stream, median_period_ns
from uav_vslam.geometry.stereo import SIDES
from uav_vslam.ins.gaps import BLIND_S, FASTEST_HZ, SLOWEST_HZ, bursts_hz
from uav_vslam.ins.preintegration import MAX_GAP_S
from uav_vslam.inspection import limits
from uav_vslam.inspection.finding import Finding, error, ok, warning
from uav_vslam.types import NS_PER_S

Stamps = NDArray[np.int64]

SENSORS = ("left", "right", "imu")
NAMES = {"left": "left images", "right": "right images", "imu": "IMU", "truth": "truth"}


def check_order(name: str, stamps_ns: Stamps) -> list[Finding]:
    """Check that (N,) stamps increase; nodes drop a message that is not after the one before."""
    if len(stamps_ns) == 0:
        return []
    if not stamps_ns.any():
        return [error(f"{name} stamps", "all header stamps are zero", "time of the reading", "let the driver set them")]
    steps = np.diff(stamps_ns)
    back, same = int((steps < 0).sum()), int((steps == 0).sum())
    if not back + same:
        return []
    last = int(np.flatnonzero(steps <= 0)[0])  # before the first of them, whose own stamp may be anything
    seen = (
        f"{back} of {len(stamps_ns)} stamps go backwards and {same} repeat the one before, first at message {last + 2} "
        f"(after {(stamps_ns[last] - stamps_ns[0]) / NS_PER_S:.2f} s)"
    )
    useless = back > limits.UNUSABLE_SHARE * len(steps) or same > limits.STUCK_SHARE * len(steps)
    judge = error if useless else warning
    remedy = "nodes drop such messages: fix the driver's clock, and let only one driver publish"
    return [judge(f"{name} stamps", seen, "each stamp after the one before", remedy)]


def check_imu_rate(stamps_ns: Stamps) -> list[Finding]:
    """Check rate and gaps of the IMU's (N,) stamps against what preintegration bridges."""
    period_s = median_period_ns(stamps_ns) / NS_PER_S
    if not np.isfinite(period_s):
        return []
    if found := _impossible_rate("IMU", stamps_ns, FASTEST_HZ):
        return found
    rate_hz = 1.0 / period_s
    if period_s > MAX_GAP_S:
        remedy = "record the IMU at its full rate"
        found.append(
            error("IMU rate", f"{rate_hz:.1f} Hz", f"at least {1 / MAX_GAP_S:.0f} Hz: else all is gap", remedy)
        )
    elif rate_hz < SLOWEST_HZ:
        allowed = f"{SLOWEST_HZ:.0f} Hz or more: faster motion is lost between readings"
        found.append(warning("IMU rate", f"{rate_hz:.1f} Hz", allowed, "record the IMU at its full rate"))
    gaps = _gaps(stamps_ns, MAX_GAP_S)
    lost = _lost(stamps_ns)
    bursts = bursts_hz(np.diff(np.unique(stamps_ns)).astype(np.int64))
    if bursts is not None:
        seen = f"{bursts[0]:.0f} Hz within bursts, {bursts[1]:.1f} Hz on average outside gaps"
        remedy = "they are stamped when bursts of them arrive: let the driver stamp the time of each reading"
        steps_s = np.minimum(_steps_s(stamps_ns), BLIND_S)  # one long pause does not make the rest useless
        judge = error if steps_s[gaps].sum() > limits.UNUSABLE_SHARE * steps_s.sum() else warning
        found.append(judge("IMU stamps", seen, "even steps", remedy))
    elif len(gaps) and period_s <= MAX_GAP_S:
        allowed = f"at most {MAX_GAP_S:g} s between readings"
        found.append(
            warning("IMU gaps", _gap_text(stamps_ns, gaps), allowed, "motion in a gap is unknown: record again")
        )
    elif lost > limits.LOST_SHARE * len(stamps_ns):
        seen, allowed = f"{lost} of {len(stamps_ns) + lost} readings are missing", f"{limits.LOST_SHARE:.0%}"
        found.append(warning("IMU gaps", seen, allowed, "check the link to the IMU, or the recorder's load"))
    return found or [ok("IMU rate", f"{rate_hz:.1f} Hz, no gaps")]


def check_image_rate(name: str, stamps_ns: Stamps, *, tracked_gap_s: float | None) -> list[Finding]:
    """Check (N,) stamps of one camera for missing images.

    Args:
        name: of the camera.
        stamps_ns: in recorded order [ns].
        tracked_gap_s: longest gap over which the front end tracks; None if it does not track [s].
    """
    period_s = median_period_ns(stamps_ns) / NS_PER_S
    if not np.isfinite(period_s):
        return []
    if found := _impossible_rate(name, stamps_ns, limits.MAX_IMAGE_RATE_HZ):
        return found
    gaps = _gaps(stamps_ns, limits.MISSING_PERIODS * period_s)
    if not len(gaps):
        return [ok(f"{name} rate", f"{1.0 / period_s:.2f} Hz, no gaps")]
    remedy = "the IMU alone bridges them: check the camera's link and the recorder's load"
    longest_s = _steps_s(stamps_ns)[gaps].max()
    if tracked_gap_s is not None and longest_s > tracked_gap_s:
        remedy += f"; tracks end after {tracked_gap_s:g} s, so set frontend.method: sift if such gaps are many"
    allowed = f"about {period_s:.3f} s, the median, between images"
    return [warning(f"{name} gaps", _gap_text(stamps_ns, gaps), allowed, remedy)]


def check_clocks(streams: Mapping[str, Stream], offset_ns: int, *, gyro_agrees: bool) -> list[Finding]:
    """Check the delay from header stamp to recording: a sensor with another delay has another clock.

    Args:
        streams: by role.
        offset_ns: IMU time minus image stamp by the calibration [ns].
        gyro_agrees: whether the gyroscope shows the cameras' rotation by the stamps: the IMU is only recorded late.
    """
    delays = _delays_s(streams, offset_ns)
    if not delays:
        return []
    usual = float(np.median(list(delays.values())))
    found = []
    for role, delay_s in delays.items():
        if abs(delay_s - usual) > REORDER_NS / NS_PER_S:
            seen = (
                f"header stamps are {_offset(delay_s)} recording time; those of the other sensors {_offset(usual)} it"
            )
            if role == "imu" and gyro_agrees:
                remedy = "the recording can be run, as the stamps agree with the images; in flight, shorten that delay"
                found.append(warning("IMU delay", seen, f"within {REORDER_NS / NS_PER_S:g} s of theirs", remedy))
                continue
            remedy = "let all drivers stamp with one clock, or correct the stamps"
            if role == "imu":
                remedy += "; an offset that stays the same can be set, see the gyroscope against the cameras"
            found.append(error(f"{NAMES[role]} clock", seen, "one clock for all sensors", remedy))
    if not found and abs(usual) > limits.OWN_CLOCK_S:
        seen = f"all header stamps are {_offset(usual)} recording time"
        remedy = "one vehicle can be run; vehicles that cooperate need one clock: synchronise them"
        found.append(warning("clock", seen, f"within {limits.OWN_CLOCK_S:g} s", remedy))
    return found or [ok("clock", f"header stamps are {_offset(usual)} recording time")]


def recorded_late_ms(streams: Mapping[str, Stream], offset_ns: int) -> int:
    """Return by how much more the IMU's stamps are late than `offset_ns` says if all is recorded at once [ms].

    It is 0 if that is within usual delays.
    """
    delays = _delays_s(streams, offset_ns)
    late_s = delays["left"] - delays["imu"] if {"left", "imu"} <= delays.keys() else 0.0
    return round(1000.0 * late_s) if abs(late_s) > REORDER_NS / NS_PER_S else 0


def check_coverage(imu_ns: Stamps, images_ns: Stamps) -> list[Finding]:
    """Check that readings (N,) are there from the first to the last image (M,)."""
    if len(imu_ns) == 0 or len(images_ns) == 0:
        return []
    margin_ns = round(MAX_GAP_S * NS_PER_S)
    before = int((images_ns < imu_ns.min() - margin_ns).sum())
    after = int((images_ns > imu_ns.max() + margin_ns).sum())
    if not before + after:
        return [ok("IMU coverage", "readings from the first to the last image")]
    seen = (
        f"{before} of {len(images_ns)} images are before the first reading and {after} after the last: readings begin "
        f"{(imu_ns.min() - images_ns.min()) / NS_PER_S:.2f} s after the first image and end "
        f"{(images_ns.max() - imu_ns.max()) / NS_PER_S:.2f} s before the last"
    )
    judge = error if before + after == len(images_ns) else warning
    remedy = "record the IMU with the images, with stamps of the same clock"
    return [judge("IMU coverage", seen, "readings from the first to the last image", remedy)]


def check_lateness(streams: Mapping[str, Stream], offset_ns: int) -> list[Finding]:
    """Check that no message is recorded so late that its place in time has passed; `offset_ns` as above."""
    there = [role for role in SENSORS if role in streams]
    parts = [(streams[role].recorded_ns, _image_clock_ns(streams, role, offset_ns)) for role in there]
    if not parts:
        return []
    recorded, stamps = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    in_order = stamps[np.argsort(recorded, kind="stable")]
    late = int((np.maximum.accumulate(in_order) - in_order > REORDER_NS).sum()) if len(in_order) else 0
    if not late:
        return []
    allowed = f"at most {REORDER_NS / NS_PER_S:g} s"
    remedy = "they are dropped: record on the vehicle's computer, with a larger cache"
    return [warning("recording", f"{late} messages are recorded later than others by more", allowed, remedy)]


def span_text(streams: Mapping[str, Stream]) -> str:
    """Return how long the images of the left camera last, in words."""
    stamps = next((streams[side].stamps_ns for side in SIDES if side in streams and len(streams[side])), None)
    return "no images" if stamps is None else f"{(stamps.max() - stamps.min()) / NS_PER_S:.1f} s of images"


def _impossible_rate(name: str, stamps_ns: Stamps, most_hz: float) -> list[Finding]:
    """Check the mean rate of (N,) stamps, which are not all the same, against what no sensor exceeds."""
    rate_hz = (len(np.unique(stamps_ns)) - 1) * NS_PER_S / float(np.ptp(stamps_ns))
    if rate_hz <= most_hz:
        return []
    remedy = "give stamps in seconds and nanoseconds: these seem to be in another unit, such as microseconds"
    return [error(f"{name} rate", f"{rate_hz:.0f} Hz on average", f"at most {most_hz:.0f} Hz", remedy)]


def _steps_s(stamps_ns: Stamps) -> NDArray[np.float64]:
    return np.asarray(np.diff(np.unique(stamps_ns)) / NS_PER_S)


def _gaps(stamps_ns: Stamps, longest_s: float) -> NDArray[np.intp]:
    return np.flatnonzero(_steps_s(stamps_ns) > longest_s)


def _lost(stamps_ns: Stamps) -> int:
    periods = _steps_s(stamps_ns) * NS_PER_S / median_period_ns(stamps_ns)
    return int(np.rint(periods[periods > limits.MISSING_PERIODS] - 1.0).sum())


def _gap_text(stamps_ns: Stamps, gaps: NDArray[np.intp]) -> str:
    steps, ordered = _steps_s(stamps_ns), np.unique(stamps_ns)
    worst = gaps[np.argsort(steps[gaps])[::-1][:3]]
    where = ", ".join(f"{steps[k]:.3g} s at {(ordered[k] - ordered[0]) / NS_PER_S:.2f} s" for k in worst)
    return f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''}: {where}{', ...' if len(gaps) > 3 else ''}"


def _delays_s(streams: Mapping[str, Stream], offset_ns: int) -> dict[str, float]:
    """Return the median delay from stamp to recording of each sensor that has messages."""
    recorded = {role: streams[role].recorded_ns for role in SENSORS if role in streams and len(streams[role])}
    return {
        role: float(np.median(recorded_ns - _image_clock_ns(streams, role, offset_ns))) / NS_PER_S
        for role, recorded_ns in recorded.items()
    }


def _image_clock_ns(streams: Mapping[str, Stream], role: str, offset_ns: int) -> Stamps:
    """Return a sensor's (N,) stamps in the images' clock [ns]."""
    return streams[role].stamps_ns - (offset_ns if role == "imu" else 0)


def _offset(delay_s: float) -> str:
    return f"{abs(delay_s):.3g} s {'before' if delay_s >= 0 else 'after'}"
