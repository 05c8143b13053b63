# SPDX-License-Identifier: Apache-2.0
"""The offline graph's start state, and the reference of its result."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uav_vslam.config import StartConfig, VehicleConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.evaluation.scores import error_scores, relative_key
from uav_vslam.offline.flight import fly
from uav_vslam.offline.result import flight_result
from uav_vslam.offline.track import track_vehicle
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_vehicle
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.saved_map import save_map
from uav_vslam.studies.engine.flights import true_trajectory
from uav_vslam.types import ImuSample, StereoFeatures, StereoFrame

IN_FLIGHT = StartConfig(method="in_flight")
FRAMES = 14


@pytest.fixture(scope="module")
def source() -> SimulatedSource:
    vehicle = simulate_vehicle(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=1), 0)
    return SimulatedSource(vehicle, scatter_landmarks([vehicle]))


def config(source: SimulatedSource, start: StartConfig) -> VehicleConfig:
    return VehicleConfig(imu=source.simulated.scenario.imu_config, start=start)


def test_an_in_flight_start_is_compared_in_its_own_frame(source: SimulatedSource) -> None:
    """The recorded start state is 70 m up in the world; in-flight initialisation puts the origin there."""
    settings = {source.vehicle: config(source, IN_FLIGHT)}
    track = track_vehicle(source, settings[source.vehicle])
    truths = {source.vehicle: true_trajectory(source.simulated)}
    result = flight_result("x", {source.vehicle: track}, {}, truths, settings).vehicles[source.vehicle]
    assert result.truth is not None
    assert len(result.s_slam) == FRAMES
    np.testing.assert_array_equal(result.s_slam.positions[0], np.zeros(3))
    np.testing.assert_allclose(result.truth.positions[0], np.zeros(3), atol=1e-9)
    assert np.linalg.norm(result.s_slam.positions[-1] - result.truth.positions[-1]) < 1.5  # after 36 m


def test_a_given_start_is_compared_in_the_world(source: SimulatedSource) -> None:
    settings = {source.vehicle: config(source, StartConfig())}
    track = track_vehicle(source, settings[source.vehicle])
    truths = {source.vehicle: true_trajectory(source.simulated)}
    result = flight_result("x", {source.vehicle: track}, {}, truths, settings).vehicles[source.vehicle]
    assert result.truth is truths[source.vehicle]
    assert abs(result.s_slam.positions[0, 2] - 70.0) < 5.0


@pytest.mark.parametrize("start", [StartConfig(), IN_FLIGHT])
def test_a_smoothed_flight_is_nearer_to_the_truth_and_leaves_the_filter_alone(
    source: SimulatedSource, start: StartConfig
) -> None:
    settings = {source.vehicle: config(source, start)}
    tracks, fleet = fly([source], settings, smoothing=True)
    track = tracks[source.vehicle]
    assert track.features == {}  # nobody asked to keep them
    alone = track_vehicle(source, settings[source.vehicle])
    assert [o.report.pose.T_map_body.t.tolist() for o in track.outputs] == [
        o.report.pose.T_map_body.t.tolist() for o in alone.outputs
    ]
    truths = {source.vehicle: true_trajectory(source.simulated)}
    result = flight_result("x", tracks, fleet, truths, settings).vehicles[source.vehicle]
    assert result.smoothed is not None
    np.testing.assert_array_equal(result.smoothed.stamps_ns, result.s_slam.stamps_ns)
    causal, smoothed = (error_scores(found, result.truth) for found in (result.s_slam, result.smoothed))
    key = relative_key(14.0, "height_m")
    assert smoothed[key] < 0.5 * causal[key]


def test_a_vehicle_that_fuses_a_map_alone_has_no_traffic(source: SimulatedSource, tmp_path: Path) -> None:
    settings = {source.vehicle: config(source, StartConfig())}
    tracks, _ = fly([source], settings, keep_maps=True)
    saved = tracks[source.vehicle].saved_map
    assert saved is not None
    save_map(saved, tmp_path / "map.npz")
    settings = {source.vehicle: config(source, StartConfig(map=str(tmp_path / "map.npz")))}
    tracks, fleet = fly([source], settings)
    flown = flight_result("x", tracks, fleet, {source.vehicle: None}, settings)
    result = flown.vehicles[source.vehicle]
    assert flown.mode == "none"
    assert result.c_slam is not None
    assert result.link.packets_sent == 0
    assert result.epochs == ()


def test_a_failed_in_flight_initialisation_says_why(source: SimulatedSource) -> None:
    blind = tuple(StereoFeatures.empty(int(stamp_ns)) for stamp_ns in source.simulated.frame_stamps_ns)
    dark = dataclasses.replace(source, features=blind)
    with pytest.raises(UavVslamError, match=rf"none of {FRAMES} frames allowed a start in flight; the last: of 0"):
        track_vehicle(dark, config(source, IN_FLIGHT))


def test_a_failed_in_flight_initialisation_says_what_is_wrong_with_the_images(source: SimulatedSource) -> None:
    class Dark(SimulatedSource):
        def iter_events(self) -> Iterator[Any]:
            black = np.zeros((self.rig.left.height, self.rig.left.width), np.uint8)
            for event in super().iter_events():
                yield event if isinstance(event, ImuSample) else StereoFrame(event.stamp_ns, black, black)

    with pytest.raises(
        UavVslamError, match=r"a start in flight; frame 1: the left camera shows nothing .*; the last: "
    ):
        track_vehicle(Dark(source.simulated, source.field), config(source, IN_FLIGHT))


def test_a_start_in_flight_without_any_pair_says_that_no_image_has_a_partner(source: SimulatedSource) -> None:
    class Unpaired(SimulatedSource):
        def iter_events(self) -> Iterator[Any]:
            return (event for event in super().iter_events() if isinstance(event, ImuSample))

    with pytest.raises(UavVslamError, match=rf"none of {FRAMES} frames was processed: unpaired {FRAMES}"):
        track_vehicle(Unpaired(source.simulated, source.field), config(source, IN_FLIGHT))


@pytest.mark.parametrize("readings", ["not finite", "absent"])
def test_a_flight_without_any_usable_imu_reading_is_no_result(source: SimulatedSource, readings: str) -> None:
    class Deaf(SimulatedSource):
        def iter_events(self) -> Iterator[Any]:
            for event in super().iter_events():
                if not isinstance(event, ImuSample):
                    yield event
                elif readings == "not finite":
                    yield dataclasses.replace(event, gyro=np.full(3, np.nan))

    count = len(source.simulated.imu.samples())
    reasons = f"not_finite {count}" if readings == "not finite" else "none is in the flight"
    with pytest.raises(UavVslamError, match=rf"uav1: no IMU reading was used \({reasons}\)"):
        track_vehicle(Deaf(source.simulated, source.field), config(source, StartConfig()))


@pytest.mark.parametrize("dark", [FRAMES // 3, FRAMES - 1])
def test_a_flight_whose_images_show_nothing_is_warned_about(source: SimulatedSource, dark: int) -> None:
    """In fog or at night no figure but the count of frames said that S-SLAM was the INS."""
    seen = [one for one in source.frames() if isinstance(one, StereoFeatures)]
    features = tuple(StereoFeatures.empty(one.stamp_ns) if k >= FRAMES - dark else one for k, one in enumerate(seen))
    blind = dataclasses.replace(source, field=None, features=features)
    told = [text for text in track_vehicle(blind, config(source, StartConfig())).warnings if "dead reckoning" in text]
    assert len(told) == (dark > FRAMES // 2)
    assert all(f"{dark} of {FRAMES} frames corrected nothing" in text for text in told)


def test_a_flying_vehicle_is_refused_by_static_alignment_with_the_remedy(source: SimulatedSource) -> None:
    with pytest.raises(UavVslamError, match=r"set start\.method: in_flight"):
        track_vehicle(source, config(source, StartConfig(method="static", rest_s=0.5)))


def test_a_recording_without_a_start_state_names_all_remedies(source: SimulatedSource) -> None:
    class Nameless:
        vehicle, rig, initial_state = source.vehicle, source.rig, None
        iter_events = source.iter_events

    with pytest.raises(UavVslamError, match=r"static for a vehicle that starts at rest, in_flight for one"):
        track_vehicle(Nameless(), config(source, StartConfig()))
