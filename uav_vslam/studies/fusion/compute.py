# SPDX-License-Identifier: Apache-2.0
"""The fusion study's tables: schemes, weights, a shared map, data association, bad radios, large fleets."""

from collections.abc import Callable

from uav_vslam.config import FUSION_ASSOCIATIONS, FUSION_WEIGHTS, MAX_PACKET_LANDMARKS, LinkConfig
from uav_vslam.simulation.scenario import SCENARIOS, Scenario
from uav_vslam.studies.engine.cooperation import Setting
from uav_vslam.studies.engine.fusion_parts import Part

BLACKOUT_S = (25.0, 85.0)
SHARED_MAP_M = 1.0
MISTAKEN_SHARES = (0.0, 0.3)
IN_74 = ("consistent", "nn", "coarse_fine", "hgtm")  # in narrowband too, as in section 7.4 of [thesis]

NOTES = {"Flights": "landmark level, 1 px, ADIS16480"}
ASSOCIATION_NOTES = {
    "Mistaken": "the share of the landmarks that both vehicles have and to which the second gives descriptors of "
    "others for the whole flight; `study frames` has each method's precision and recall",
}


def schemes(frames: int) -> list[Part]:
    """The fusion schemes, the thesis's among them, the weights of an intersection, and what makes a plain sum fail."""
    weights = [Setting(f"full_ci, {name}", {"scheme": "full_ci", "weighing": name}) for name in FUSION_WEIGHTS[1:]]
    overlay, feedback, ends = {"scheme": "overlay"}, {"feedback": True}, ("uav1", "uav3")
    everything = overlay | {"max_packet_landmarks": MAX_PACKET_LANDMARKS, "budget_bytes_per_s": 10_000_000}
    settings = (
        Setting("split_ci"),
        Setting("split_ci, feedback", feedback),
        Setting("split_ci, narrowband", {"mode": "narrowband"}),
        Setting("full_ci, position_trace", {"scheme": "full_ci"}),
        *weights,
        Setting("inverse_ci", {"scheme": "inverse_ci"}),
        Setting("overlay", overlay),
        Setting("overlay, feedback", overlay | feedback),
        Setting("full sharing", everything),
        Setting("full sharing, feedback", everything | feedback),
        Setting("CI per landmark, written back", write_back="landmark_ci"),
        Setting("CI per landmark, written back, own maps", write_back="landmark_ci_own"),
        Setting("CI per landmark, overwritten", write_back="overwrite"),
        Setting("information deltas", write_back="deltas"),
        Setting("information deltas, own maps", write_back="deltas_own"),
    )
    shared = (Setting("split_ci, map named", {"prior_id": "map"}), Setting("overlay", overlay))
    three = (
        Setting("split_ci, ring"),
        Setting("overlay, ring", overlay),
        Setting("overlay, ring, relays", overlay | {"relay": True}),
        Setting("split_ci, ring, feedback", feedback),
        Setting("overlay, ring, feedback", overlay | feedback),
        Setting("overlay, row", overlay, out_of_range=ends),
        Setting("overlay, row, relay", overlay | {"relay": True}, out_of_range=ends),
        Setting("split_ci, row, feedback", feedback, out_of_range=ends),
        Setting("overlay, row, feedback", overlay | feedback, out_of_range=ends),
    )
    in_shared_map = Scenario(frames=frames, sigma_map_m=SHARED_MAP_M)
    return [
        Part("schemes", Scenario(frames=frames), settings),
        Part(f"both start in one map that is {SHARED_MAP_M:g} m off", in_shared_map, shared),
        Part("three vehicles, in a ring and in a row", Scenario(frames=frames, vehicles=3), three),
    ]


def association(frames: int) -> list[Part]:
    """Each method of data association between vehicles, and section 7.4's also in narrowband."""
    settings = (
        *(Setting(name, {"association": name}) for name in FUSION_ASSOCIATIONS),
        *(Setting(f"{name}, narrowband", {"association": name, "mode": "narrowband"}) for name in IN_74),
    )
    return [
        Part(f"association, {share:.0%} mistaken", Scenario(frames=frames), settings, mistaken_share=share)
        for share in MISTAKEN_SHARES
    ]


def network() -> list[Part]:
    """Long flights that separate half-way, over bad radios and with restarts of the sender."""
    losses = [Setting(f"loss {share:.0%}", link=LinkConfig(loss=share)) for share in (0.0, 0.2, 0.5, 0.7, 0.9)]
    settings = (
        *losses,
        Setting("duplication 40%", link=LinkConfig(duplication=0.4)),
        Setting("reordering, up to 3 s", link=LinkConfig(jitter_s=3.0)),
        Setting("delay 1 s", link=LinkConfig(delay_s=1.0)),
        Setting("blackout of 60 s", link=LinkConfig(blackouts=BLACKOUT_S)),
        Setting(
            "narrowband, 9.6 kbit/s, loss 20%", {"mode": "narrowband"}, LinkConfig(rate_bytes_per_s=1200, loss=0.2)
        ),
        Setting("5 restarts of the sender", restarts=5),
        Setting("no memory", {"memory_landmarks": 0}),
    )
    return [Part("a long flight that separates half-way", SCENARIOS["parting"], settings)]


def fleets(frames: int) -> list[Part]:
    """Fleets of growing size."""
    sizes = [Scenario(frames=frames, vehicles=count) for count in (2, 4, 8)]
    ends = ("uav1", "uav3")
    row = (
        Setting("all in range"),
        Setting("ends out of range", out_of_range=ends),
        Setting("the middle returns feedback", {"feedback": True}, out_of_range=ends),
        Setting("the middle relays", {"relay": True}, out_of_range=ends),
    )
    return [
        *(Part(f"{size.vehicles} vehicles", size, (Setting("split_ci"),)) for size in sizes),
        Part("three in a row", Scenario(frames=frames, vehicles=3), row),
    ]


PARTS: dict[str, Callable[[int], list[Part]]] = {
    "schemes": schemes,
    "association": association,
    "network": lambda frames: network(),
    "fleets": fleets,
}
