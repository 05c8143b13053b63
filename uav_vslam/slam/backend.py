# SPDX-License-Identifier: Apache-2.0
"""The own-only SLAM of one vehicle, frame by frame: predict, associate, update, manage the map.

Nothing that came over a network enters here.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_vslam.association.consensus import consensus
from uav_vslam.association.guided import associate
from uav_vslam.config import VehicleConfig
from uav_vslam.estimation.filter import Innovation
from uav_vslam.estimation.filters import make_filter
from uav_vslam.estimation.observation import projectable
from uav_vslam.geometry.image_grid import spread
from uav_vslam.geometry.pose import Pose
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.slam.landmark_map import LandmarkMap
from uav_vslam.slam.map_manager import MapView, leaving
from uav_vslam.slam.relocalisation import locate, relocalise
from uav_vslam.types import (
    NS_PER_S,
    ImuIncrement,
    JointInformation,
    NavEstimate,
    PoseEstimate,
    StereoFeatures,
)

Rows = NDArray[np.intp]

SIGNIFICANCE = 1e-6  # matches that right ones would disagree as much as so rarely are not believed together
VIEW_MARGIN_PX = 50.0  # a landmark predicted so far outside the image may still be seen


@dataclass(frozen=True, slots=True)
class FrameReport:
    """What became of one frame.

    Attributes:
        pose: own-only pose with its covariance.
        nav: the whole navigation estimate, for the INS.
        features: stereo points offered.
        associated: landmarks that corrected the state; 0 means that the vehicle coasted on its INS.
        relocalised: the gate failed and the whole map was searched.
        innovation: None without an update.
        landmarks: landmarks in the state afterwards.
    """

    pose: PoseEstimate
    nav: NavEstimate
    features: int
    associated: int
    relocalised: bool
    innovation: Innovation | None
    landmarks: int


@dataclass(frozen=True, slots=True)
class _Association:
    """Pairs of landmark rows and feature rows, and where to linearise when the mean is far off."""

    landmarks: Rows
    features: Rows
    linearise_at: Pose | None = None
    relocalised: bool = False

    def __len__(self) -> int:
        return len(self.landmarks)


class SlamBackend:
    """A filter, its map, and the loop over frames."""

    def __init__(
        self, initial: NavEstimate, *, rig: StereoRig, config: VehicleConfig, vehicle: str, session: int = 1
    ) -> None:
        self._config = config.backend
        self._vehicle, self._session = vehicle, session
        self._filter = make_filter(initial, rig=rig, config=config)
        self._map = LandmarkMap()
        self._frame = 0

    @property
    def stamp_ns(self) -> int:
        """Time of the estimate [ns]."""
        return self._filter.nav.stamp_ns

    @property
    def landmarks(self) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        """Identifiers (N,) and positions (N, 3) [m] of the landmarks in the state."""
        return self._map.ids, self._filter.landmarks

    def process(self, features: StereoFeatures, increment: ImuIncrement | None) -> FrameReport:
        """Advance to a frame and correct by what it shows.

        Args:
            features: stereo points of the frame.
            increment: motion since the estimate's stamp; None only when the frame has that very stamp.

        Raises:
            ValueError: the increment does not lead from the estimate to the frame.
        """
        self._advance(features.stamp_ns, increment)
        pairs, innovation = self._correct(features)
        nav = self._filter.nav_estimate()  # map management leaves it alone, but would have P computed anew
        self._make_room()
        self._add_landmarks(pairs, features)
        self._frame += len(features) > 0  # a frame that shows nothing tells nothing of the landmarks either
        return FrameReport(
            pose=nav.pose,
            nav=nav,
            features=len(features),
            associated=len(pairs),
            relocalised=pairs.relocalised,
            innovation=innovation,
            landmarks=len(self._map),
        )

    def joint_information(self) -> JointInformation:
        """Return the belief over pose and landmarks, for the vehicle's own fusion."""
        return JointInformation(
            stamp_ns=self.stamp_ns,
            vehicle=self._vehicle,
            session=self._session,
            T_map_body=self._filter.nav.T_map_body,
            ids=self._map.ids.copy(),
            positions=self._filter.landmarks.copy(),
            information=self._filter.pose_landmark_information(),
            descriptors=self._map.descriptors.copy(),
        )

    def _advance(self, stamp_ns: int, increment: ImuIncrement | None) -> None:
        if increment is None:
            if stamp_ns != self.stamp_ns:
                raise ValueError(f"frame at {stamp_ns} ns needs the motion since {self.stamp_ns} ns")
            return
        if (increment.start_ns, increment.stamp_ns) != (self.stamp_ns, stamp_ns):
            raise ValueError(
                f"increment {increment.start_ns} to {increment.stamp_ns} ns does not lead from the estimate at "
                f"{self.stamp_ns} ns to the frame at {stamp_ns} ns"
            )
        self._filter.predict(increment)

    @property
    def _rig(self) -> StereoRig:
        return self._filter.rig

    def _correct(self, features: StereoFeatures) -> tuple[_Association, Innovation | None]:
        """Update by the first set of matches that agrees with the prediction as a whole; without one, coast.

        A relocalisation is believed against the prediction: it is tried when the prediction has led nowhere.
        """
        pixels = features.pixels.astype(float)
        for pairs in self._candidates(features):
            innovation = self._filter.update(
                pairs.landmarks,
                pixels[pairs.features],
                linearise_at=pairs.linearise_at,
                significance=0.0 if pairs.relocalised else SIGNIFICANCE,
            )
            if innovation.accepted:
                self._map.observe(pairs.landmarks, features.descriptors[pairs.features], self._frame)
                return pairs, innovation
        return _Association(np.zeros(0, np.intp), np.zeros(0, np.intp)), None

    def _candidates(self, features: StereoFeatures) -> Iterator[_Association]:
        """Yield sets of matches, the cheapest first: all in the gate, those confirmed by PnP, those that agree with
        one another, and those found in the whole map without a gate.
        """
        if len(self._map) == 0 or len(features) == 0:
            return
        gated, vague = self._guided(features)
        if not vague and len(gated) >= self._config.min_pnp_inliers:
            yield self._selected(gated, features)
        for found in (self._verified, self._agreeing):
            pairs = found(gated, features)
            if pairs is not None:
                yield self._selected(pairs, features)
        searched = self._searched(features)
        if searched is not None:
            yield self._selected(searched, features)

    def _guided(self, features: StereoFeatures) -> tuple[_Association, bool]:
        """Return the gated matches, and whether the prediction was too vague for the gate to be trusted alone."""
        rows = np.flatnonzero(projectable(self._rig, self._filter.points_left(), margin_px=VIEW_MARGIN_PX))
        if len(rows) == 0:
            return _Association(rows, np.zeros(0, np.intp)), True
        predicted = self._filter.predict_observations(rows)
        matches = associate(
            predicted.expected,
            predicted.S,
            self._map.descriptors[rows],
            features.pixels.astype(float),
            features.descriptors,
            probability=self._config.gate_probability,
            ratio=self._config.min_descriptor_ratio,
        )
        sigma_px = np.sqrt(np.trace(predicted.S, axis1=1, axis2=2) / 4.0)
        vague = bool(np.median(sigma_px) > self._config.pnp_beyond_px)
        return _Association(rows[matches[:, 0]], matches[:, 1]), vague

    def _verified(self, pairs: _Association, features: StereoFeatures) -> _Association | None:
        """Keep the matches that agree on one pose by PnP; None where too few do."""
        found = locate(
            self._rig,
            self._filter.nav.T_map_body,
            self._filter.landmarks[pairs.landmarks],
            features.pixels[pairs.features],
            threshold_px=self._config.pnp_px,
            min_inliers=self._config.min_pnp_inliers,
        )
        if found is None:
            return None
        T_map_body, inliers = found
        return _Association(pairs.landmarks[inliers], pairs.features[inliers], self._far_pose(T_map_body))

    def _agreeing(self, pairs: _Association, features: StereoFeatures) -> _Association | None:
        """Keep the largest set of matches that agree with one another; None where it is too small."""
        chosen = self._selected(pairs, features)
        nu, S = self._filter.joint_innovation(chosen.landmarks, features.pixels[chosen.features].astype(float))
        rows = consensus(nu, S, probability=self._config.gate_probability)
        if len(rows) < self._config.min_pnp_inliers:
            return None
        return _Association(chosen.landmarks[rows], chosen.features[rows])

    def _searched(self, features: StereoFeatures) -> _Association | None:
        """Match against the whole map without a gate; None where PnP does not confirm enough."""
        found = relocalise(
            self._rig,
            self._filter.nav.T_map_body,
            self._filter.landmarks,
            self._map.descriptors,
            features,
            config=self._config,
        )
        if found is None:
            return None
        T_map_body, landmarks, rows = found
        return _Association(landmarks, rows, self._far_pose(T_map_body), True)

    def _far_pose(self, T_map_body: Pose) -> Pose | None:
        moved = np.linalg.norm(T_map_body.t - self._filter.nav.T_map_body.t)
        return T_map_body if moved > self._config.iterate_beyond_m else None

    def _selected(self, pairs: _Association, features: StereoFeatures) -> _Association:
        """Cap the number of updates, oldest landmarks first, spread over the image."""
        order = np.argsort(self._map.born[pairs.landmarks], kind="stable")
        pixels = features.pixels[pairs.features[order], :2]
        chosen = order[spread(pixels, self._config.max_observations, size=self._image_size)]
        return _Association(pairs.landmarks[chosen], pairs.features[chosen], pairs.linearise_at, pairs.relocalised)

    def _make_room(self) -> None:
        if len(self._map) == 0:
            return
        in_view = projectable(self._rig, self._filter.points_left())
        view = MapView(self._map, self._filter.landmarks, self._variance, in_view, self._frame)
        gone = leaving(view, self._config)
        if len(gone):
            self._filter.marginalise(gone)
            self._map.remove(gone)

    def _variance(self) -> NDArray[np.float64]:
        return np.diagonal(self._filter.covariance())[-3 * len(self._map) :].reshape(-1, 3).sum(axis=1)

    def _add_landmarks(self, pairs: _Association, features: StereoFeatures) -> None:
        points_left = self._filter.points_left()
        in_view = projectable(self._rig, points_left)
        room = min(
            self._config.max_new_landmarks,
            self._config.max_in_view - int(in_view.sum()),
            self._config.max_landmarks - len(self._map),
        )
        if room <= 0 or len(features) == 0:
            return
        free = np.setdiff1d(np.arange(len(features)), pairs.features)
        free = free[np.isfinite(self._rig.triangulate(features.pixels[free])).all(axis=1)]
        taken = self._rig.left.project(points_left[in_view])
        chosen = free[spread(features.pixels[free, :2], room, size=self._image_size, taken=taken)]
        if len(chosen):
            self._filter.add_landmarks(features.pixels[chosen].astype(float))
            self._map.append(features.descriptors[chosen], self._frame)

    @property
    def _image_size(self) -> tuple[int, int]:
        return self._rig.left.width, self._rig.left.height


def crosses_epoch(previous_ns: int | None, stamp_ns: int, epoch_s: float) -> bool:
    """Tell whether a multiple of the epoch lies in (previous, stamp]: then packets are made and fused.

    It depends on stamps alone, so that all nodes of a vehicle agree without asking one another.
    """
    period = round(epoch_s * NS_PER_S)
    return previous_ns is not None and stamp_ns // period != previous_ns // period
