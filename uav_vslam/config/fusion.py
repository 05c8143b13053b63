# SPDX-License-Identifier: Apache-2.0
"""Cooperation with peers."""

from dataclasses import dataclass

from uav_vslam.config.settings import Settings, refuse, setting

FUSION_SCHEMES = ("split_ci", "full_ci", "overlay", "inverse_ci")
FUSION_WEIGHTS = ("position_trace", "trace", "determinant", "niehsen", "franken_hupper")
FUSION_ASSOCIATIONS = (  # the names in cooperation.peer_associators.PEER_ASSOCIATORS
    "consistent",
    "gated",
    "nn",
    "ransac",
    "gtm",
    "hgtm",
    "gated_ransac",
    "gated_gtm",
    "gated_hgtm",
    "cds",
    "coarse_fine",
)
# Communication modes, and what a vehicle may send in each: payload, before DDS, UDP and IP [B/s].
MODE_BUDGETS = {"wideband": 100_000, "narrowband": 900, "none": 0}
MAX_PACKET_LANDMARKS = 400  # a packet with more is rejected: the cost of checking is cubic


@dataclass(frozen=True, slots=True)
class FusionConfig(Settings):
    """Cooperation with peers."""

    mode: str = setting("wideband", "communication mode", choices=MODE_BUDGETS, live=True)
    budget_bytes_per_s: int = setting(0, "largest payload rate; 0: that of the mode", unit="B/s", at_least=0, live=True)
    silent_after_s: float = setting(
        5.0, "a peer of which nothing is received for longer is reported as silent", unit="s", above=0, live=True
    )
    epoch_s: float = setting(
        1.0,
        "period of fusions and packets, at frames that pass a multiple (narrowband: two packets in three)",
        unit="s",
        at_least=0.01,
    )
    scheme: str = setting("split_ci", "how packets are fused", choices=FUSION_SCHEMES)
    weighing: str = setting(
        "position_trace", "what the own weight of a covariance intersection minimises", choices=FUSION_WEIGHTS
    )
    prior_id: str = setting("", "hash of a loaded map or shared survey that the start state depends on; empty for none")
    common_origin: bool = setting(
        True, "all maps start at one known point and heading; otherwise each peer's frame is estimated"
    )
    feedback: bool = setting(
        False,
        "wideband: send each peer the fused estimate of its landmarks; pays where some vehicles are out of each "
        "other's range (row of three: ATE 0.44 instead of 0.54 of own-only); no gain for a pair, and costs time",
        live=True,
    )
    relay: bool = setting(False, "forward peers' packets unchanged to those out of their range", live=True)
    memory_landmarks: int = setting(
        40, "shared landmarks that are remembered after they have left the filter's state", at_least=0
    )
    max_packet_landmarks: int = setting(
        64, "landmarks in one packet", at_least=1, at_most=MAX_PACKET_LANDMARKS, live=True
    )
    association: str = setting(
        "consistent",
        "data association with peers' landmarks; consistent: by descriptor, gate and consistency with each other; the "
        "others need common_origin",
        choices=FUSION_ASSOCIATIONS,
    )
    ratio: float = setting(0.8, "descriptor ratio test between vehicles, before the gate", above=0, at_most=1)
    gate_probability: float = setting(
        0.99, "that a correct pair of landmarks passes its chi-square gate", above=0, below=1
    )
    min_common: int = setting(
        2, "pairs that must agree with each other before any is used; two at least without common_origin", at_least=1
    )
    floor_sigma_m: float = setting(
        0.3,
        "standard deviation added to each packet landmark: two descriptors rarely show exactly the same point",
        unit="m",
        at_least=0,
    )
    fleet_key_file: str = setting(
        "", "file of the fleet's shared secret, 16 bytes or more: packets without its tag are dropped"
    )
    signing_key_file: str = setting("", "instead of fleet_key_file: this vehicle's own Ed25519 key (PEM)")
    peer_keys_folder: str = setting(
        "", "with signing_key_file: folder of <vehicle>.pem, the public key of every vehicle"
    )

    def _check_together(self) -> None:
        if self.fleet_key_file and self.signing_key_file:
            refuse("fleet_key_file", self.fleet_key_file, "either a fleet key or signing keys")
        if bool(self.signing_key_file) != bool(self.peer_keys_folder):
            refuse("peer_keys_folder", self.peer_keys_folder, "signing_key_file and peer_keys_folder together")
        if not self.common_origin and self.association != FUSION_ASSOCIATIONS[0]:
            allowed = f"{FUSION_ASSOCIATIONS[0]} where common_origin is false: the alignment decides about pairs"
            refuse("association", self.association, allowed)

    @property
    def returns_feedback(self) -> bool:
        """Whether peers receive the fused estimate of their landmarks: only in wideband."""
        return self.feedback and self.mode == "wideband"
