# SPDX-License-Identifier: Apache-2.0
"""A vehicle's own-only pipeline over its data; a flight without a result, or one in doubt, says why."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from uav_vslam.config import VehicleConfig
from uav_vslam.errors import BagError, FilterDivergence, UavVslamError
from uav_vslam.geometry.stereo import StereoRig
from uav_vslam.ins.alignment import biased_rest
from uav_vslam.offline.source import FlightSource, start_state
from uav_vslam.pipeline import VehiclePipeline, VehicleTrack
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.slam.health import COASTING_REMEDY, MIN_FEATURES
from uav_vslam.slam.rolling_shutter import exposed_at_once
from uav_vslam.slam.saved_map import Mapped
from uav_vslam.smoothing.flight import FilteredFlight
from uav_vslam.smoothing.smoother import smooth
from uav_vslam.types import StereoFeatures

COASTING_SHARE = 0.5  # of the frames, from which the whole flight is in doubt


class VehicleFlight:
    """One vehicle's own-only pipeline over its data; a damaged recording is used up to the damage.

    Iterate once over its outputs; `track` is complete afterwards.
    """

    def __init__(
        self,
        source: FlightSource,
        config: VehicleConfig,
        *,
        keep_features: bool = False,
        keep_joints: bool = True,
        keep_map: bool = False,
        smoothing: bool = False,
    ) -> None:
        """Prepare.

        Args:
            source: sensor data.
            config: of the vehicle.
            keep_features: in the track, for pictures.
            keep_joints: in the track, to be fused afterwards.
            keep_map: in the track.
            smoothing: smooth the whole flight afterwards, and the map.

        Raises:
            UavVslamError: the source has no start state and the configuration does not set how to find one.
        """
        cv2.setNumThreads(1)
        self._source, self._config = source, config
        self._keep_features, self._keep_map, self._smoothing = keep_features, keep_map, smoothing
        start = start_state(source, config)
        self._pipeline = VehiclePipeline(
            start,
            rig=source.rig,
            config=config,
            vehicle=source.vehicle,
            keep_features=keep_features or smoothing,
            keep_joints=keep_joints,
            keep_map=keep_map,
        )
        if start is not None and config.start.method == "static" and (biased := biased_rest(start, config.imu)):
            self.track.warnings.append(biased)

    @property
    def track(self) -> VehicleTrack:
        """The flight so far."""
        return self._pipeline.track

    def __iter__(self) -> Iterator[FrameOutput]:
        """Yield the output of each frame.

        Raises:
            UavVslamError: no start state was found, no frame was processed, or no IMU reading used.
        """
        try:
            yield from self._pipeline.run(self._source.iter_events())
        except BagError as error:
            self.track.broken = str(error)
        _warn_of_unpaired(self._source, self.track)
        if self._pipeline.missing_start and (self.track.frames_in or self.track.broken):
            noticed = "".join(f"{text}; " for text in self.track.warnings)  # what is missing may follow from it
            raise UavVslamError(
                f"{self.track.vehicle}: none of {self.track.frames_in} frames allowed a start in flight; "
                f"{noticed}the last: {self._pipeline.missing_start}"
            )
        _count_unpaired(self._source, self.track)
        _check_measured(self.track)
        _report_coasting(self.track)
        self._finish()

    def _finish(self) -> None:
        mapped = None
        if self._keep_map:
            with _warning_of(self.track, "the map could not be saved"):
                mapped = self._pipeline.mapped()
        if self._smoothing:
            mapped = smooth_track(self.track, self._source.rig, self._config, mapped)
        if mapped is not None:
            with _warning_of(self.track, "the map could not be saved"):
                self.track.saved_map = mapped.saved_map()
        if not self._keep_features:
            self.track.features.clear()


def track_vehicle(source: FlightSource, config: VehicleConfig, **options: bool) -> VehicleTrack:
    """Return the track of a whole `VehicleFlight`, which takes the same arguments and raises the same errors."""
    flight = VehicleFlight(source, config, **options)
    for _ in flight:
        pass
    return flight.track


def smooth_track(
    track: VehicleTrack, rig: StereoRig, config: VehicleConfig, mapped: Mapped | None = None
) -> Mapped | None:
    """Smooth the poses of a track that keeps its features, or add why it failed; return the landmarks, smoothed too."""
    if track.start is None or not track.outputs:
        return mapped
    with _warning_of(track, "the flight could not be smoothed"):
        outputs = _last_outputs(track)
        flight = FilteredFlight.of_outputs(track.start, outputs, _exposed_at_once(track, outputs, rig))
        found = smooth(flight, rig, config, mapped)
        track.smoothed, mapped = [estimate.pose for estimate in found.estimates], found.mapped
    return mapped


def _last_outputs(track: VehicleTrack) -> list[FrameOutput]:
    """Return the last output of each frame: some may have been used again."""
    found: list[FrameOutput] = []
    for output in track.outputs:
        if output.earlier:
            found = list(output.earlier)
        found.append(output)
    return found


def _exposed_at_once(track: VehicleTrack, outputs: list[FrameOutput], rig: StereoRig) -> dict[int, StereoFeatures]:
    """Return a track's features as the back end used them."""
    found = {}
    for output in outputs:
        nav, readout_s = output.report.nav.state, output.readout_s
        shown = track.features[nav.stamp_ns]
        found[nav.stamp_ns] = exposed_at_once(shown, nav, output.increment, rig=rig, readout_s=readout_s)
    return found


@contextmanager
def _warning_of(track: VehicleTrack, failure: str) -> Iterator[None]:
    """Add a failure of the estimation to the warnings of a track, and go on."""
    try:
        yield
    except (FilterDivergence, np.linalg.LinAlgError, MemoryError) as error:
        track.warnings.append(f"{failure}: {error}")


def _count_unpaired(source: FlightSource, track: VehicleTrack) -> None:
    """Count frames by the images recorded, not by the pairs found.

    Raises:
        UavVslamError: no frame was processed.
    """
    alone = source.frame_count - track.frames_in
    if alone > 0:
        track.dropped["unread" if track.broken else "unpaired"] = alone
        track.frames_in = source.frame_count
    if track.outputs or track.broken or source.frame_count == 0:
        return
    reasons = ", ".join(f"{reason} {count}" for reason, count in track.dropped.items()) or "the IMU does not cover any"
    detail = f"; {source.unpaired_reason()}" if alone > 0 else ""
    raise UavVslamError(f"{source.vehicle}: none of {source.frame_count} frames was processed: {reasons}{detail}")


def _warn_of_unpaired(source: FlightSource, track: VehicleTrack) -> None:
    """Warn if most images of a whole recording found no partner, and why; if all, no frame is processed."""
    alone = source.frame_count - track.frames_in
    if alone > track.frames_in > 0 and not track.broken:
        text = f"{alone} of {source.frame_count} left images found no partner: {source.unpaired_reason()}"
        track.warnings.append(text)


def _check_measured(track: VehicleTrack) -> None:
    """Check that the flight is more than a guess.

    Raises:
        UavVslamError: no IMU reading was used.
    """
    increments = [output.increment for output in track.outputs if output.increment is not None]
    if increments and not any(increment.samples for increment in increments):
        reasons = ", ".join(f"{reason} {count}" for reason, count in track.dropped.items()) or "none is in the flight"
        raise UavVslamError(
            f"{track.vehicle}: no IMU reading was used ({reasons}), so all motion is unknown; uav-vslam check says "
            "what is wrong with the recording"
        )


def _report_coasting(track: VehicleTrack) -> None:
    """Warn of a flight that is mostly dead reckoning, though its frames have features or because they have not."""
    coasted = [output.report for output in track.outputs if output.report.coasted]
    missed = sum(report.features >= MIN_FEATURES for report in coasted)
    frames, most = len(track.outputs), COASTING_SHARE * len(track.outputs)
    if missed > most:
        track.warnings.append(
            f"{missed} of {frames} frames had features, but none where the estimate expects it: what it claims is in "
            f"doubt; {COASTING_REMEDY} (uav-vslam check)"
        )
    elif len(coasted) > most:
        track.warnings.append(
            f"{len(coasted)} of {frames} frames corrected nothing, {len(coasted) - missed} of them with fewer than "
            f"{MIN_FEATURES} features: the estimate is mostly dead reckoning; check light, exposure and focus, and the "
            "calibration, by which matches are judged (uav-vslam check)"
        )
