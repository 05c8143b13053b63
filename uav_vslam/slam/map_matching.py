# SPDX-License-Identifier: Apache-2.0
"""Which feature shows which landmark: sets of matches to try, the cheapest first.

1. all that the associator of the configuration finds; the default one looks in the gates of the prediction,
2. those of them that agree on one pose by PnP,
3. those that agree with one another,
4. those found in the whole map without a gate, and confirmed by PnP.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association import ASSOCIATORS, Associator, InView
from uav_vslam.association.consensus import consensus
from uav_vslam.config import BackendConfig
from uav_vslam.estimation.filter import Filter
from uav_vslam.estimation.observation import projectable
from uav_vslam.geometry.image_grid import spread
from uav_vslam.geometry.pose import Pose
from uav_vslam.slam.known_tracks import tracks_first
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.relocalisation import locate, relocalise
from uav_vslam.slam.revisits import recognise
from uav_vslam.types import StereoFeatures

Rows = NDArray[np.intp]

VIEW_MARGIN_PX = 50.0  # a landmark predicted so far outside the image may still be seen


@dataclass(frozen=True, slots=True)
class Matches:
    """Pairs of landmark rows and feature rows, and where to linearise when the mean is far off."""

    landmarks: Rows
    features: Rows
    linearise_at: Pose | None = None
    relocalised: bool = False

    @staticmethod
    def none() -> "Matches":
        """Return no match."""
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp))

    def __len__(self) -> int:
        return len(self.landmarks)

    def chosen(self, rows: Rows, linearise_at: Pose | None = None) -> "Matches":
        """Return some of the matches."""
        return Matches(self.landmarks[rows], self.features[rows], linearise_at, self.relocalised)


class MapMatcher:
    """Matches one frame after another against a filter's map."""

    def __init__(self, config: BackendConfig, associate: Associator | None = None) -> None:
        """Match as configured, or with an associator that is given in the configured one's place."""
        self._config = config
        self._associate = associate or ASSOCIATORS[config.association]

    def candidates(
        self, belief: Filter, landmark_map: LandmarkMap, features: StereoFeatures, frame: int
    ) -> Iterator[Matches]:
        """Yield sets of matches to try one after the other.

        Args:
            belief: predicted to the frame.
            landmark_map: looks and history of its landmarks.
            features: of the frame.
            frame: its number.
        """
        if len(landmark_map) == 0 or len(features) == 0:
            return
        gated, vague = self._guided(belief, landmark_map, features, frame)
        if not vague and len(gated) >= self._config.min_pnp_inliers:
            yield self._capped(belief, landmark_map, features, gated)
        attempts = (
            lambda: self._verified(belief, features, gated),
            lambda: self._agreeing(belief, features, self._capped(belief, landmark_map, features, gated)),
            lambda: self._searched(belief, landmark_map, features),
        )
        for attempt in attempts:  # each only once the one before was refused
            found = attempt()
            if found is not None:
                yield self._capped(belief, landmark_map, features, found)

    def _guided(
        self, belief: Filter, landmark_map: LandmarkMap, features: StereoFeatures, frame: int
    ) -> tuple[Matches, bool]:
        """Return the gated matches, and whether the prediction was too vague for the gate to be trusted alone.

        Landmarks that come back with a wide gate choose first, and together: what looks like one of them has often
        become another landmark before they were believed.
        """
        rows = np.flatnonzero(projectable(belief.rig, belief.points_left(), margin_px=VIEW_MARGIN_PX))
        if len(rows) == 0:
            return Matches.none(), True
        predicted = belief.predict_observations(rows)
        sigma_px = np.sqrt(np.trace(predicted.S, axis1=1, axis2=2) / 4.0)
        vague = bool(np.median(sigma_px) > self._config.pnp_beyond_px)
        back = landmark_map.long_unseen(frame)[rows] & (sigma_px > self._config.pnp_beyond_px)
        revisited = recognise(belief, landmark_map, features, rows[back], config=self._config)
        free = np.setdiff1d(np.arange(len(features)), revisited[:, 1])
        others = rows[~back]
        statistics = landmark_map.statistics.chosen(others)
        in_view = InView(
            others, predicted.expected[~back], predicted.S[~back], landmark_map.descriptors[others], statistics
        )
        matches = tracks_first(
            self._associate, in_view, landmark_map.tracks[others], features.chosen(free), self._config
        )
        pairs = np.vstack([revisited, np.column_stack([others[matches[:, 0]], free[matches[:, 1]]])])
        return Matches(pairs[:, 0], pairs[:, 1]), vague

    def _verified(self, belief: Filter, features: StereoFeatures, pairs: Matches) -> Matches | None:
        """Keep the matches that agree on one pose by PnP; None where too few do."""
        found = locate(
            belief.rig,
            belief.nav.T_map_body,
            belief.landmarks[pairs.landmarks],
            features.pixels[pairs.features],
            threshold_px=self._config.pnp_px,
            min_inliers=self._config.min_pnp_inliers,
        )
        if found is None:
            return None
        T_map_body, inliers = found
        return pairs.chosen(inliers, self._far_pose(belief, T_map_body))

    def _agreeing(self, belief: Filter, features: StereoFeatures, pairs: Matches) -> Matches | None:
        """Keep the largest set of matches that agree with one another; None where it is too small."""
        nu, S = belief.joint_innovation(pairs.landmarks, features.pixels[pairs.features].astype(float))
        rows = consensus(nu, S, probability=self._config.gate_probability)
        return pairs.chosen(rows) if len(rows) >= self._config.min_pnp_inliers else None

    def _searched(self, belief: Filter, landmark_map: LandmarkMap, features: StereoFeatures) -> Matches | None:
        """Match against the whole map without a gate; None where PnP does not confirm enough."""
        found = relocalise(
            belief.rig, belief.nav.T_map_body, belief.landmarks, landmark_map.descriptors, features, config=self._config
        )
        if found is None:
            return None
        T_map_body, landmarks, rows = found
        return Matches(landmarks, rows, self._far_pose(belief, T_map_body), True)

    def _far_pose(self, belief: Filter, T_map_body: Pose) -> Pose | None:
        moved = np.linalg.norm(T_map_body.t - belief.nav.T_map_body.t)
        return T_map_body if moved > self._config.iterate_beyond_m else None

    def _capped(self, belief: Filter, landmark_map: LandmarkMap, features: StereoFeatures, pairs: Matches) -> Matches:
        """Cap the number of updates, oldest landmarks first, spread over the image."""
        order = np.argsort(landmark_map.born[pairs.landmarks], kind="stable")
        size = (belief.rig.left.width, belief.rig.left.height)
        chosen = order[spread(features.pixels[pairs.features[order], :2], self._config.max_observations, size=size)]
        return pairs.chosen(chosen, pairs.linearise_at)
