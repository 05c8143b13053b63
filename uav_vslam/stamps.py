# SPDX-License-Identifier: Apache-2.0
"""Which stamps of a stream are believed: one that leaps far ahead would make all later ones seem too old."""

from uav_vslam.errors import InvalidMessage
from uav_vslam.types import NS_PER_S

IMU_TIME_JUMP_S = 5.0  # no inertial unit that works is silent for so long
IMAGE_LEAP_S = 30.0  # recordings thinned by what the cameras show have gaps of many seconds


class TimeJumpGuard:
    """Refuses a stamp far ahead of all before it, unless the next one comes soon after it: then time did go on.

    Whether stamps rise at all is left to whoever needs that.
    """

    def __init__(self, what: str, leap_s: float) -> None:
        """Guard a stream.

        Args:
            what: names it in the error, e.g. "IMU".
            leap_s: how far ahead a stamp is believed at once [s].
        """
        self._what, self._leap_ns = what, leap_s * NS_PER_S
        self._newest_ns: int | None = None
        self._leapt_ns: int | None = None

    def check(self, stamp_ns: int) -> None:
        """Take note of the next stamp [ns].

        Raises:
            InvalidMessage: it leaps ahead, and the one before did not leap as far; drop what bears it.
        """
        newest_ns = stamp_ns if self._newest_ns is None else self._newest_ns
        if stamp_ns - newest_ns > self._leap_ns and not self._confirmed(stamp_ns):
            self._leapt_ns = stamp_ns
            raise InvalidMessage(
                "stamp_leap",
                f"{self._what} stamp {stamp_ns} ns is {(stamp_ns - newest_ns) / NS_PER_S:.1f} s after the newest, more "
                f"than {self._leap_ns / NS_PER_S:g} s; it is believed once the next one is near it",
            )
        self._newest_ns, self._leapt_ns = max(newest_ns, stamp_ns), None

    def _confirmed(self, stamp_ns: int) -> bool:
        return self._leapt_ns is not None and 0 < stamp_ns - self._leapt_ns <= self._leap_ns
