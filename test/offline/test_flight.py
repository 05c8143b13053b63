# SPDX-License-Identifier: Apache-2.0
"""A fleet is fused while it flies: the same as fused afterwards, from one process or several, and no belief is kept."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from uav_vslam.config import FusionConfig, StartConfig, VehicleConfig
from uav_vslam.errors import UavVslamError
from uav_vslam.fleet import CooperativeTrack, cooperate
from uav_vslam.offline.flight import fly
from uav_vslam.offline.track import track_vehicle
from uav_vslam.offline.workers import FlightGroup
from uav_vslam.pipeline import VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.frame_output import FrameOutput
from uav_vslam.types import StereoFeatures

FRAMES = 40


@pytest.fixture(scope="module")
def sources() -> list[SimulatedSource]:
    fleet = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=3, seed=2))
    landmarks = scatter_landmarks(fleet)
    return [SimulatedSource(vehicle, landmarks) for vehicle in fleet]


@pytest.fixture(scope="module")
def configs(sources: list[SimulatedSource]) -> dict[str, VehicleConfig]:
    imu = sources[0].simulated.scenario.imu_config
    return {source.vehicle: VehicleConfig(imu=imu, fusion=FusionConfig(feedback=False)) for source in sources}


@pytest.fixture(scope="module")
def tracks(sources: list[SimulatedSource], configs: dict[str, VehicleConfig]) -> dict[str, VehicleTrack]:
    return {source.vehicle: track_vehicle(source, configs[source.vehicle]) for source in sources}


def states(fleet: dict[str, CooperativeTrack]) -> dict[str, list[bytes]]:
    return {
        name: [pose.T_map_body.t.tobytes() + pose.covariance.tobytes() for pose in member.poses]
        for name, member in fleet.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_fused_in_flight_is_as_fused_afterwards(
    sources: list[SimulatedSource], configs: dict[str, VehicleConfig], tracks: dict[str, VehicleTrack], workers: int
) -> None:
    frames: list[int] = []
    flown, fleet = fly(sources, configs, workers=workers, on_frame=frames.append)
    afterwards = cooperate(tracks, configs)
    assert list(flown) == list(fleet) == [source.vehicle for source in sources]
    assert sum(frames) == 3 * FRAMES
    assert states(fleet) == states(afterwards)
    for name, member in fleet.items():
        used = [record.used for record in member.fusion.inbox.peers.values()]
        assert used == [record.used for record in afterwards[name].fusion.inbox.peers.values()]
        assert min(used) > 0
        assert not any(output.joint for output in flown[name].outputs)
        kept, recorded = flown[name].landmarks.landmarks(), tracks[name].landmarks.landmarks()
        assert set(kept.ids.tolist()) == {i for o in tracks[name].outputs if o.joint for i in o.joint.ids.tolist()}
        np.testing.assert_array_equal(kept.covariances, recorded.covariances)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(
    ("start", "told"),
    [
        (StartConfig(method="static"), "uav2: the vehicle moves"),  # before the first frame
        (StartConfig(method="in_flight"), f"uav2: none of {FRAMES} frames allowed a start"),  # after the last
    ],
)
def test_what_ends_one_vehicle_ends_the_flight_by_its_name(
    sources: list[SimulatedSource], configs: dict[str, VehicleConfig], start: StartConfig, told: str, workers: int
) -> None:
    dark = tuple(StereoFeatures.empty(stamp_ns) for stamp_ns in sources[1].simulated.frame_stamps_ns.tolist())
    blind = SimulatedSource(sources[1].simulated, features=dark)
    settings = configs | {"uav2": dataclasses.replace(configs["uav2"], start=start)}
    with pytest.raises(UavVslamError, match=told):
        fly([sources[0], blind, sources[2]], settings, workers=workers)


def test_a_flight_goes_on_without_the_epochs_whose_fusion_diverges_and_warns_of_them(
    sources: list[SimulatedSource], configs: dict[str, VehicleConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = FlightGroup.frames

    def with_a_fault(group: FlightGroup) -> Iterator[tuple[str, FrameOutput]]:
        for vehicle, output in frames(group):
            joint = output.joint
            if joint is not None and vehicle == "uav2":
                joint = dataclasses.replace(joint, information=-joint.information)
            yield vehicle, dataclasses.replace(output, joint=joint)

    monkeypatch.setattr(FlightGroup, "frames", with_a_fault)
    flown, fleet = fly(sources[:2], configs)
    assert [len(member.poses) for member in fleet.values()] == [len(track.outputs) for track in flown.values()]
    assert not any("could not be fused" in text for text in flown["uav1"].warnings)
    (told,) = [text for text in flown["uav2"].warnings if "could not be fused" in text]
    assert told.startswith("5 of 5 epochs")
