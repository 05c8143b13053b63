# SPDX-License-Identifier: Apache-2.0
"""Filter health: re-initialises the filter when its innovations show divergence or it is lost."""

from collections import deque

from uav_vslam.estimation.weighted_update import Innovation

WINDOW = 20  # frames
MAX_NIS_PER_DOF = 4.0  # over a window a consistent filter is within a few percent of 1, a badly tuned one below 2
MAX_LOST = 30  # consecutive frames with enough features, none of which passes a gate
MIN_FEATURES = 20  # fewer, in the frame or in the map, are too few to judge
COASTING_REMEDY = "check start state, units of the IMU, clocks and calibration"  # of frames that match no prediction


class FilterHealth:
    """Monitors the innovations of a filter."""

    def __init__(self) -> None:
        self._recent: deque[Innovation] = deque(maxlen=WINDOW)
        self._lost = 0

    def check(self, innovation: Innovation | None, *, features: int, known: int) -> str:
        """Add a frame and return why the filter must be re-initialised; empty if it need not.

        Args:
            innovation: of the frame's update; None, or with no degree of freedom, if all was rejected.
            features: stereo points offered.
            known: landmarks in the state before the frame, or tracks that it continues.
        """
        if innovation is not None and innovation.dof:
            self._recent.append(innovation)
            self._lost = 0
        elif features >= MIN_FEATURES and known >= MIN_FEATURES:
            self._lost += 1
        nis_per_dof = self.nis_per_dof
        if len(self._recent) == WINDOW and nis_per_dof > MAX_NIS_PER_DOF:
            return f"NIS of {WINDOW} frames is {nis_per_dof:.1f} times its degrees of freedom"
        if self._lost >= MAX_LOST:
            return f"no landmark associated and no track accepted for {self._lost} frames: {COASTING_REMEDY}"
        return ""

    @property
    def nis_per_dof(self) -> float:
        """NIS over the window divided by its degrees of freedom; 1 for a consistent filter."""
        return sum(i.nis for i in self._recent) / max(sum(i.dof for i in self._recent), 1)
