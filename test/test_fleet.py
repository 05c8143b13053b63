# SPDX-License-Identifier: Apache-2.0
"""The offline twin's radio: packets go through the links between the vehicles and within the senders' budgets."""

import dataclasses
import itertools

import numpy as np
import pytest

from uav_vslam.config import FusionConfig, LinkConfig, VehicleConfig
from uav_vslam.cooperation.link import Link
from uav_vslam.errors import FilterDivergence
from uav_vslam.fleet import CooperativeTrack, Fleet, PacketLink, cooperate, in_stamp_order, named
from uav_vslam.pipeline import VehiclePipeline, VehicleTrack
from uav_vslam.simulation.landmarks import scatter_landmarks
from uav_vslam.simulation.scenario import SCENARIOS, simulate_fleet
from uav_vslam.simulation.source import SimulatedSource
from uav_vslam.slam.frame_output import FrameOutput

FRAMES = 40  # 5.5 s: five epochs
VEHICLES = ("uav1", "uav2", "uav3")


@pytest.fixture(scope="module")
def tracks() -> dict[str, VehicleTrack]:
    fleet = simulate_fleet(dataclasses.replace(SCENARIOS["kagaru"], frames=FRAMES, vehicles=len(VEHICLES), seed=1))
    landmarks, found = scatter_landmarks(fleet), {}
    for vehicle in fleet:
        source = SimulatedSource(vehicle, landmarks)
        config = VehicleConfig(imu=vehicle.scenario.imu_config)
        pipeline = VehiclePipeline(source.initial_state, rig=source.rig, config=config, vehicle=source.vehicle)
        for _ in pipeline.run(source.iter_events()):
            pass
        found[source.vehicle] = pipeline.track
    assert tuple(found) == VEHICLES
    return found


def configs(**fusion: object) -> dict[str, VehicleConfig]:
    return dict.fromkeys(VEHICLES, VehicleConfig(fusion=FusionConfig(**fusion)))


def received(member: CooperativeTrack) -> dict[str, int]:
    return {peer: record.received for peer, record in member.fusion.inbox.peers.items()}


@pytest.mark.slow
def test_without_links_every_packet_reaches_every_peer(tracks: dict[str, VehicleTrack]) -> None:
    fleet = cooperate(tracks, configs(feedback=False))
    sent = {name: member.exchange.outbox.packets_sent for name, member in fleet.items()}
    assert min(sent.values()) >= 5
    for name, member in fleet.items():
        assert received(member) == {peer: count for peer, count in sent.items() if peer != name}


def damaged(output: FrameOutput) -> FrameOutput:
    """Return a frame whose joint information has lost its positive definiteness."""
    assert output.joint is not None
    return dataclasses.replace(output, joint=dataclasses.replace(output.joint, information=-output.joint.information))


def test_an_epoch_whose_fusion_diverges_costs_that_vehicle_the_epoch_and_no_other_anything(
    tracks: dict[str, VehicleTrack],
) -> None:
    (at, bad), *_ = [(k, damaged(o)) for k, o in enumerate(tracks["uav2"].outputs) if o.joint is not None][2:]
    outputs = [*tracks["uav2"].outputs[:at], bad, *tracks["uav2"].outputs[at + 1 :]]
    faulty = tracks | {"uav2": dataclasses.replace(tracks["uav2"], outputs=outputs)}
    frames = list(in_stamp_order(named(name, track.outputs) for name, track in faulty.items()))
    strict, lenient = Fleet(VEHICLES, configs()), Fleet(VEHICLES, configs(), goes_on=True)
    for frame in frames[: next(k for k, (_, output) in enumerate(frames) if output is bad)]:
        strict.add(*frame)
    with pytest.raises(FilterDivergence):
        strict.add("uav2", bad)
    for frame in frames:
        lenient.add(*frame)
    lenient.land()
    for name, member in lenient.members.items():
        assert len(member.poses) == len(tracks[name].outputs)
        assert len(member.epochs) >= 5 - (name == "uav2")
        assert list(member.failures) == ([bad.report.pose.stamp_ns] if name == "uav2" else [])
    (warning,) = lenient.members["uav2"].warnings
    assert "1 of 5 epochs could not be fused" in warning
    assert "positive definite" in warning
    assert lenient.members["uav1"].warnings == []


def test_a_peer_whose_landmarks_look_like_others_is_named_once_where_nothing_leaves_its_pairs_out(
    tracks: dict[str, VehicleTrack],
) -> None:
    """Descriptors are rolled by one landmark: nearest neighbours, without a gate, pair all of uav2's wrongly."""

    def confused(output: FrameOutput) -> FrameOutput:
        if output.joint is None:
            return output
        descriptors = np.roll(output.joint.descriptors, 1, axis=0)
        return dataclasses.replace(output, joint=dataclasses.replace(output.joint, descriptors=descriptors))

    outputs = [confused(output) for output in tracks["uav2"].outputs]
    flown = tracks | {"uav2": dataclasses.replace(tracks["uav2"], outputs=outputs)}
    fleet = cooperate(flown, configs(feedback=False, association="nn"))
    (warning,) = [text for text in fleet["uav1"].warnings if "uav2" in text]
    assert "contradict the own estimate" in warning
    (count,) = [n for text, n in fleet["uav1"].contradictions.items() if "uav2" in text]
    assert warning.endswith(f"at {count} of {len(fleet['uav1'].epochs)} epochs")
    assert all(member.warnings == [] for member in cooperate(tracks, configs()).values())


@pytest.mark.parametrize(("off_m", "named"), [(20.0, True), (0.0, False)])
def test_a_peer_whose_start_is_far_off_is_named_though_nothing_of_it_is_fused(
    tracks: dict[str, VehicleTrack], off_m: float, named: bool
) -> None:
    """All of uav2's map is moved; its start state claims 5 cm."""

    def moved(output: FrameOutput) -> FrameOutput:
        if output.joint is None:
            return output
        positions = output.joint.positions + np.array([off_m, 0.0, 0.0])
        return dataclasses.replace(output, joint=dataclasses.replace(output.joint, positions=positions))

    flown = {name: tracks[name] for name in ("uav1", "uav2")}
    flown["uav2"] = dataclasses.replace(tracks["uav2"], outputs=[moved(output) for output in tracks["uav2"].outputs])
    fleet = cooperate(flown, configs())
    texts = fleet["uav1"].warnings
    assert any("the map of uav2 is displaced" in text for text in texts) is named
    assert (fleet["uav1"].fusion.inbox.peers["uav2"].used == 0) is named


def test_each_direction_has_a_link_of_its_own(tracks: dict[str, VehicleTrack]) -> None:
    made: dict[tuple[str, str], PacketLink] = {}

    def deaf_to_uav1(sender: str, receiver: str) -> PacketLink:
        return made.setdefault((sender, receiver), Link(LinkConfig(loss=float(sender == "uav1"))))

    fleet = cooperate(tracks, configs(feedback=False), deaf_to_uav1)
    assert set(made) == {(a, b) for a in VEHICLES for b in VEHICLES if a != b}
    assert set(received(fleet["uav1"])) == {"uav2", "uav3"}
    assert set(received(fleet["uav2"])) == {"uav3"}
    assert made["uav1", "uav2"].packets["lost"] == fleet["uav1"].exchange.outbox.packets_sent


def test_a_packet_counts_from_when_it_arrives(tracks: dict[str, VehicleTrack]) -> None:
    early = cooperate(tracks, configs(), lambda a, b: Link(LinkConfig(delay_s=0.1)))
    late = cooperate(tracks, configs(), lambda a, b: Link(LinkConfig(delay_s=2.5)))
    assert sum(received(early["uav1"]).values()) > sum(received(late["uav1"]).values()) > 0
    after_2_8_s = [fleet["uav1"].poses[20].T_map_body.t.tolist() for fleet in (early, late)]
    assert after_2_8_s[0] != after_2_8_s[1]  # the one had packets to fuse by then, the other none


def test_a_packet_that_comes_twice_is_counted_and_changes_nothing(tracks: dict[str, VehicleTrack]) -> None:
    once = cooperate(tracks, configs())
    twice = cooperate(tracks, configs(), lambda a, b: Link(LinkConfig(duplication=1.0)))
    for name in VEHICLES:
        dropped = [record.dropped["duplicate"] for record in twice[name].fusion.inbox.peers.values()]
        assert dropped == [record.received for record in once[name].fusion.inbox.peers.values()]
        assert [p.T_map_body.t.tolist() for p in twice[name].poses] == [
            p.T_map_body.t.tolist() for p in once[name].poses
        ]


def test_what_the_budget_has_no_room_for_reaches_nobody(tracks: dict[str, VehicleTrack]) -> None:
    fleet = cooperate(tracks, configs(budget_bytes_per_s=1))
    for member in fleet.values():
        assert member.exchange.outbox.packets_sent == 0
        assert member.exchange.dropped["budget"] >= 5
        assert received(member) == {}


@pytest.mark.parametrize("rate", [0, 4000])  # as the mode has it; so little that packets leave no room for feedback
def test_feedback_is_paid_for_as_packets_are(tracks: dict[str, VehicleTrack], rate: int) -> None:
    made: dict[tuple[str, str], PacketLink] = {}
    pair, settings = {name: tracks[name] for name in VEHICLES[:2]}, configs(feedback=True, budget_bytes_per_s=rate)
    fleet = cooperate(pair, settings, lambda *ends: made.setdefault(ends, Link(LinkConfig())))
    for (sender, _), link in made.items():
        exchange, epochs = fleet[sender].exchange, sum(output.joint is not None for output in tracks[sender].outputs)
        outbox, held_back = exchange.outbox, exchange.dropped["budget"]
        assert (link.packets["offered"], link.size_bytes["offered"]) == (outbox.packets_sent, outbox.bytes_sent)
        assert outbox.packets_sent + held_back > epochs  # there was feedback
        assert (held_back > 0) == (rate > 0)


def test_a_relay_forwards_packets_between_vehicles_out_of_range(tracks: dict[str, VehicleTrack]) -> None:
    def ends_apart(sender: str, receiver: str) -> PacketLink:
        return Link(LinkConfig(loss=float({sender, receiver} == {"uav1", "uav3"})))

    alone, relayed = (cooperate(tracks, configs(relay=relay), ends_apart) for relay in (False, True))
    assert set(received(alone["uav1"])) == {"uav2"}
    assert set(received(relayed["uav1"])) == {"uav2", "uav3"}
    record, sent = relayed["uav1"].fusion.inbox.peers["uav3"], relayed["uav3"].exchange.outbox.packets_sent
    assert 0 < record.received <= sent
    assert record.used
    assert record.packets[-1].sources == ("uav3/1",)


def test_the_epochs_end_with_what_the_counters_say_and_never_fall(tracks: dict[str, VehicleTrack]) -> None:
    for member in cooperate(tracks, configs(feedback=False)).values():
        epochs = member.epochs
        outbox = member.exchange.outbox
        assert (epochs[-1].packets_sent, epochs[-1].bytes_sent) == (outbox.packets_sent, outbox.bytes_sent)
        assert epochs[-1].packets_used == sum(record.used for record in member.fusion.inbox.peers.values())
        for before, after in itertools.pairwise(epochs):
            assert before.stamp_ns < after.stamp_ns
            assert before.bytes_sent <= after.bytes_sent
            assert before.bytes_received <= after.bytes_received
        assert set(member.fusion_s) == {epoch.stamp_ns for epoch in epochs}
