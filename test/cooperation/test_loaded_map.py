# SPDX-License-Identifier: Apache-2.0
"""What depends on one saved map is never counted as independent, and the map itself is evidence like a packet."""

import dataclasses

import numpy as np
import pytest

from uav_vslam.config import FusionConfig
from uav_vslam.cooperation.exchange import Exchange
from uav_vslam.cooperation.fused_pose import FusedEpoch
from uav_vslam.cooperation.fusion import Fusion
from uav_vslam.fleet import Air, LinkTransport, Sent
from uav_vslam.slam.packet import PacketPolicy, checksum, make_packet
from uav_vslam.slam.saved_map import MapOrigin, Mapped, MappedPlace, SavedMap
from uav_vslam.types import NS_PER_S, JointInformation, LandmarkPacket

COUNT, NOW_NS = 8, 10 * NS_PER_S
TRUTH = np.column_stack([np.random.default_rng(3).uniform(-30, 30, (COUNT, 2)), np.zeros(COUNT)])
POSITION = np.array([0.0, 0.0, 70.0])
MAP_M, OWN_M = 2.0, 0.2  # the error of a map that all in it share, and each vehicle's own
DRAWS = 60
CONFIG = FusionConfig(floor_sigma_m=0.05)


def covariance(shared_m: float) -> np.ndarray:
    """Return (6+3N, 6+3N): a shift that pose and landmarks share, and errors of their own."""
    rows = np.r_[0:3, 6 : 6 + 3 * COUNT]
    shift = np.zeros((6 + 3 * COUNT, 3))
    shift[rows] = np.tile(np.eye(3), (1 + COUNT, 1))
    own = np.full(len(shift), OWN_M**2)
    own[3:6] = 1e-6
    return shared_m**2 * shift @ shift.T + np.diag(own)


@pytest.fixture
def belief(make_joint):
    """Return a maker of beliefs of vehicles that started in a map whose frame is `shift` off."""

    def make(name: str, shift: np.ndarray, rng: np.random.Generator, **changes: object) -> JointInformation:
        points = TRUTH + shift + OWN_M * rng.normal(size=TRUTH.shape)
        joint = make_joint(points, covariance(MAP_M), vehicle=name, stamp_ns=NOW_NS)
        at = dataclasses.replace(joint.T_map_body, t=POSITION + shift + OWN_M * rng.normal(size=3))
        return dataclasses.replace(joint, T_map_body=at, **{"prior_id": "abcd", "other_sources": ("uav9/1",)} | changes)

    return make


def packet_of(joint: JointInformation) -> LandmarkPacket:
    return make_packet(
        dataclasses.replace(joint, stamp_ns=NOW_NS - NS_PER_S), sequence=1, policy=PacketPolicy(max_landmarks=COUNT)
    )


def fuse(own: JointInformation, *packets: LandmarkPacket, loaded: SavedMap | None = None, **settings) -> FusedEpoch:
    fusion = Fusion(own.vehicle, dataclasses.replace(CONFIG, **settings), loaded)
    for packet in packets:
        fusion.inbox.add(packet)
    return fusion.fuse(own)


def saved_map(joint: JointInformation, *, sources: tuple[str, ...] = ()) -> SavedMap:
    """Return a map with the landmarks of a belief."""
    place = MappedPlace.of(
        joint.ids,
        joint.positions,
        joint.covariance[6:, 6:],
        descriptors=joint.descriptors,
        observations=np.ones(COUNT, np.uint32),
    )
    return Mapped(MapOrigin("uav9", 1, "uav9/map", NOW_NS, sources), (place,)).saved_map()


DEPENDENCE = {
    "one map": ({}, True),
    "two maps of one flight": ({"prior_id": "efgh"}, True),
    "a map made from a map": ({"prior_id": "efgh", "other_sources": ("uav8/1", "uav9/1")}, True),
    "maps of two flights": ({"prior_id": "efgh", "other_sources": ("uav8/1",)}, False),
    "no map": ({"prior_id": "", "other_sources": ()}, False),
    "the map's own maker": ({"prior_id": "", "other_sources": (), "vehicle": "uav9"}, True),
}


@pytest.mark.parametrize("case", DEPENDENCE)
def test_packets_are_dependent_where_maps_have_measurements_in_common(belief, case: str) -> None:
    changes, dependent = DEPENDENCE[case]
    rng = np.random.default_rng(4)
    own, peer = belief("uav1", np.zeros(3), rng), belief("uav2", np.zeros(3), rng, **changes)
    epoch = fuse(own, packet_of(peer))
    assert sum(epoch.common.values()) >= COUNT // 2
    assert is_dependent(epoch) is dependent


def is_dependent(epoch: FusedEpoch) -> bool:
    """Return whether nearly nothing was gained; independent evidence as good as the own belief halves the variance."""
    before, after = (np.trace(pose.covariance[:3, :3]) for pose in (epoch.own, epoch.pose))
    assert after > 0.9 * before or after < 0.6 * before
    return bool(after > 0.9 * before)


def nees_of(epoch: FusedEpoch) -> float:
    error = epoch.pose.T_map_body.t - POSITION
    return float(error @ np.linalg.solve(epoch.pose.covariance[:3, :3], error) / 3.0)


def test_two_vehicles_in_one_map_stay_consistent_and_a_plain_sum_does_not(belief) -> None:
    rng = np.random.default_rng(5)
    values: dict[str, list[float]] = {"split_ci": [], "overlay": [], "not declared": []}
    for _ in range(DRAWS):
        shift = MAP_M * rng.normal(size=3)
        own, peer = (belief(name, shift, rng) for name in ("uav1", "uav2"))
        for scheme in ("split_ci", "overlay"):
            values[scheme].append(nees_of(fuse(own, packet_of(peer), scheme=scheme)))
        bare = [dataclasses.replace(one, prior_id="", other_sources=()) for one in (own, peer)]
        values["not declared"].append(nees_of(fuse(bare[0], packet_of(bare[1]))))
    three_sigma = 3.0 * np.sqrt(2.0 / (3 * DRAWS))
    assert np.mean(values["split_ci"]) < 1.0 + three_sigma
    assert min(np.mean(values["overlay"]), np.mean(values["not declared"])) > 1.0 + 2.0 * three_sigma


@pytest.mark.parametrize("started_in_it", [True, False])
def test_the_map_itself_adds_to_an_independent_start_and_is_intersected_with_a_dependent_one(
    belief, started_in_it: bool
) -> None:
    rng = np.random.default_rng(6)
    loaded = saved_map(belief("uav9", np.zeros(3), rng))
    prior = {"prior_id": loaded.hash, "other_sources": loaded.origin.sources}
    own = belief("uav1", np.zeros(3), rng, **(prior if started_in_it else {"prior_id": "", "other_sources": ()}))
    epoch = fuse(own, loaded=loaded, mode="none")
    assert epoch.map_landmarks >= COUNT // 2
    assert epoch.common == {}  # nothing that a peer shares
    assert is_dependent(epoch) is started_in_it


def test_a_packet_is_dependent_on_a_map_that_was_fused_before(belief) -> None:
    """The own start owes nothing to the map, but the fused belief does."""
    rng = np.random.default_rng(7)
    loaded = saved_map(belief("uav9", np.zeros(3), rng))
    own = belief("uav1", np.zeros(3), rng, prior_id="", other_sources=())
    peer = belief("uav2", np.zeros(3), rng, prior_id=loaded.hash, other_sources=loaded.origin.sources)
    alone, with_map = fuse(own, packet_of(peer)), fuse(own, packet_of(peer), loaded=loaded)
    assert not is_dependent(alone)
    gained = np.trace(with_map.pose.covariance[:3, :3]) / np.trace(alone.pose.covariance[:3, :3])
    assert gained > 0.9  # three independent ones would give two thirds


def test_only_sections_near_the_vehicle_are_held_as_packets(belief) -> None:
    rng, km = np.random.default_rng(2), np.array([1000.0, 0.0, 0.0])
    joints = [belief("uav9", k * km, rng, prior_id="", other_sources=()) for k in range(4)]
    places = [saved_map(joint).sections[0] for joint in joints]
    fusion = Fusion("uav1", CONFIG, SavedMap(MapOrigin("uav9", 1, "uav9/map", NOW_NS), tuple(places)))
    for k in range(4):
        own = belief("uav1", k * km, rng, stamp_ns=NOW_NS + k * NS_PER_S)
        assert fusion.fuse(own).map_landmarks > 0
        assert list(fusion._loaded._packets) == [k]


def test_a_map_of_ground_far_away_is_not_used(belief) -> None:
    rng = np.random.default_rng(8)
    own = belief("uav1", np.zeros(3), rng)
    loaded = saved_map(belief("uav9", np.array([900.0, 0.0, 0.0]), rng))
    epoch = fuse(own, loaded=loaded)
    assert epoch.map_landmarks == 0
    np.testing.assert_array_equal(epoch.pose.covariance, epoch.own.covariance)


def test_declared_sources_pass_the_radio_and_feedback_in_a_packet_s_place_does_not(belief) -> None:
    air, fusion = Air(("uav1", "uav2")), Fusion("uav1", CONFIG)
    exchange = Exchange(fusion, ["uav2"], LinkTransport(air, "uav1"), CONFIG)
    exchange.configure(CONFIG)
    packet = packet_of(belief("uav2", np.zeros(3), np.random.default_rng(9)))
    nameless = dataclasses.replace(packet, prior_id="")
    for sent in (packet, dataclasses.replace(nameless, checksum=checksum(nameless))):
        air.send("uav2", "uav1", Sent(sent))
    air.deliver(0)
    assert fusion.inbox.peers["uav2"].received == 1
    assert exchange.dropped["sources"] == 1
