# SPDX-License-Identifier: Apache-2.0
"""The result of one frame of the own-only SLAM."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uav_vslam.estimation.rig_belief import DisparityEstimate, TimeOffset
from uav_vslam.estimation.weighted_update import Innovation
from uav_vslam.types import NavEstimate, PoseEstimate


@dataclass(frozen=True, slots=True)
class FrameReport:
    """What the back end has made of a frame.

    Attributes:
        pose: own-only pose with its covariance.
        nav: the whole navigation estimate, for the INS.
        features: stereo points offered.
        associated: points that corrected the state, landmarks and tracks; 0 means dead reckoning.
        relocalised: gating failed and the whole map was searched.
        innovation: None without an update.
        landmarks: landmarks in the state afterwards.
        recovery: why the filter was re-initialised at this frame; empty if it was not.
        as_calibrated: `nav` with the covariance that it has if the calibration is right; None if re-initialised.
        rig_evidence: how strongly the data contradict the calibration, see `Filter.rig_evidence`.
        disparity: its constant error as the filter estimates it; None if it does not.
        time_offset: of the cameras' clock as the filter estimates it; None if it does not.
        closures: associated landmarks that had not been seen for long.
        doubting: what `nav` is without trusting a calibration that is not judged yet; None if it is.
        tracked: stereo points whose track was in the frame before.
        renewed: those of them that say nothing yet: all views of their tracks up to this frame have been used.
        coasted: the state was propagated by the IMU alone; not so a frame at the start state itself, nor one that
            corrected it by tracks which are all used up with it.
        gate_probability: of the gate on observations.
        sightings: (K, 2) identifier and feature row of each point that corrected the state, and of each new landmark.
        late_sightings: (K, 2) the same of the frame before, if its landmarks had to wait for the angular rate.
        smoothed: the oldest past pose as it leaves the window; None until that is full, and without one.
        flexing: the rig counts as flexing, as configured or because its images have shown that it vibrates.
    """

    pose: PoseEstimate
    nav: NavEstimate
    features: int
    associated: int
    relocalised: bool
    innovation: Innovation | None
    landmarks: int
    recovery: str = ""
    as_calibrated: NavEstimate | None = None
    rig_evidence: float = 0.0
    disparity: DisparityEstimate | None = None
    time_offset: TimeOffset | None = None
    closures: int = 0
    doubting: NavEstimate | None = None
    tracked: int = 0
    renewed: int = 0
    coasted: bool = False
    gate_probability: float = 1.0
    sightings: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    late_sightings: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    smoothed: PoseEstimate | None = None
    flexing: bool = False

    def could_correct(self, landmarks: int) -> int:
        """Return how many points could have corrected the state, with `landmarks` in the map before the frame."""
        return max(self.tracked, min(self.features, landmarks)) - self.renewed
