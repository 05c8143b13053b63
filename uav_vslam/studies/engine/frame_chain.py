# SPDX-License-Identifier: Apache-2.0
"""A flight as a factor graph of GTSAM that grows frame by frame."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray

from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.studies.engine.factors import (
    Cameras,
    motion_factor,
    start_factor,
    state_values,
    to_bias,
    to_nav_state,
    to_pose,
)
from uav_vslam.types import NavEstimate, StereoFeatures

Identities = NDArray[np.int64]  # (N,) of the landmark that each feature shows, -1 for a wrong match


class FrameChain:
    """The factors and first values that each frame adds to a graph.

    Attributes:
        frame: number of the newest frame; -1 before the first.
        state, bias: its current estimate; the optimiser updates them.
        landmark_keys: of the landmarks in the graph, by identity; remove a landmark from the graph and from here.
        landmarks_made: number of keys ever given.
    """

    def __init__(self, start: NavEstimate, rig: StereoRig, cameras: Cameras) -> None:
        self._start, self._rig, self._cameras = start, rig, cameras
        self.frame = -1
        self.state, self.bias = to_nav_state(start.state), to_bias(start.state)
        self.landmark_keys: dict[int, int] = {}
        self.landmarks_made = 0

    def add(
        self,
        features: StereoFeatures,
        identities: Identities,
        motion: gtsam.PreintegratedCombinedMeasurements | None,
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Advance by a motion and add features; the first frame, whose state is the start, has no motion.

        Raises:
            ValueError: the motion to a later frame is missing, or the first frame has one.
        """
        self.frame += 1
        if motion is None and self.frame > 0:
            raise ValueError(f"frame {self.frame} needs the motion since the one before")
        if motion is not None and self.frame == 0:
            raise ValueError("frame 0 is the start and takes no motion")
        graph = gtsam.NonlinearFactorGraph()
        if motion is None:
            graph.push_back(start_factor(self._start))
        else:
            graph.push_back(motion_factor(self.frame, motion))
            self.state = motion.predict(self.state, self.bias)
        values = state_values(self.frame, self.state, self.bias)
        self._add_landmarks(values, features, identities)
        rows = [row for row, identity in enumerate(identities.tolist()) if identity in self.landmark_keys]
        keys = [self.landmark_keys[identity] for identity in identities[rows].tolist()]
        self._cameras.add(graph, features.pixels[rows].astype(float), X(self.frame), keys)
        return graph, values

    def _add_landmarks(self, values: gtsam.Values, features: StereoFeatures, identities: Identities) -> None:
        """Give a key and a first value to each landmark that is new and can be triangulated."""
        new = [row for row, i in enumerate(identities.tolist()) if i >= 0 and i not in self.landmark_keys]
        T_map_left = to_pose(self.state.pose()) @ self._rig.T_body_left
        points = T_map_left.apply(self._rig.triangulate(features.pixels[new]))
        for identity, point in zip(identities[new].tolist(), points, strict=True):
            if np.isfinite(point).all():
                self.landmark_keys[identity] = L(self.landmarks_made)
                values.insert(L(self.landmarks_made), point)
                self.landmarks_made += 1
