# SPDX-License-Identifier: Apache-2.0
"""Nearest stamps, and time-jump detection: one accepted stamp far ahead would make all later ones seem too old."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.errors import InvalidMessage
from uav_vslam.types import NS_PER_S

IMU_TIME_JUMP_S = 5.0  # a working IMU is never silent for so long
IMAGE_TIME_JUMP_S = 30.0  # recordings reduced to keyframes have gaps of many seconds


def nearest(stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the index of the nearest other stamp to each one; of two as near, that of the earlier.

    Args:
        stamps_ns: (N,) in any order [ns].
        others_ns: (M,) ascending, at least one [ns].
    """
    after = np.searchsorted(others_ns, stamps_ns).clip(0, len(others_ns) - 1)
    before = (after - 1).clip(0)
    nearer = np.abs(others_ns[before] - stamps_ns) <= np.abs(others_ns[after] - stamps_ns)
    return np.asarray(np.where(nearer, before, after))


class TimeJumpGuard:
    """Rejects a stamp far ahead of all before it, unless the next stamp confirms the jump by being close to it.

    Callers that need increasing stamps check that themselves.
    """

    def __init__(self, what: str, jump_s: float) -> None:
        """Guard a stream.

        Args:
            what: name in the error, e.g. "IMU".
            jump_s: largest step that is accepted without confirmation [s].
        """
        self._what, self._jump_ns = what, jump_s * NS_PER_S
        self._newest_ns: int | None = None
        self._unconfirmed_ns: int | None = None

    def check(self, stamp_ns: int) -> None:
        """Check the next stamp [ns].

        Raises:
            InvalidMessage: it jumps ahead, and the previous stamp does not confirm it; drop the message.
        """
        newest_ns = stamp_ns if self._newest_ns is None else self._newest_ns
        if stamp_ns - newest_ns > self._jump_ns and not self._confirmed(stamp_ns):
            self._unconfirmed_ns = stamp_ns
            raise InvalidMessage(
                "stamp_jump",
                f"{self._what} stamp {stamp_ns} ns is {(stamp_ns - newest_ns) / NS_PER_S:.1f} s after the newest, more "
                f"than {self._jump_ns / NS_PER_S:g} s; it is accepted once the next one is close to it",
            )
        self._newest_ns, self._unconfirmed_ns = max(newest_ns, stamp_ns), None

    def _confirmed(self, stamp_ns: int) -> bool:
        return self._unconfirmed_ns is not None and 0 < stamp_ns - self._unconfirmed_ns <= self._jump_ns
