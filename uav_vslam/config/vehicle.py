# SPDX-License-Identifier: Apache-2.0
"""The settings of one vehicle: the one home of their defaults, units and ranges."""

from dataclasses import dataclass, field

from uav_vslam.config.imu import ImuConfig
from uav_vslam.config.input import InputConfig
from uav_vslam.config.settings import Settings, refuse, setting

LEAST_DISPARITY_SIGMA_PX = 1e-6  # a smaller one makes the information singular to working precision
START_METHODS = ("given", "static", "in_flight", "map")


@dataclass(frozen=True, slots=True)
class StartConfig(Settings):
    """How a vehicle gets its start state."""

    method: str = setting(
        "given",
        "given: topic initial_state; static: gravity at rest; in_flight: gravity and stereo odometry; map: as "
        "in_flight, with the pose in the map of start.map",
        choices=START_METHODS,
    )
    rest_s: float = setting(1.0, "static: time over which readings are averaged", unit="s", above=0)
    map: str = setting(
        "", "file of a map to fly in: fusion corrects by it, and method map starts in it; empty for none"
    )
    velocity_sigma: float = setting(
        5.0,
        "in_flight: prior standard deviation of the start's velocity, per axis; map: largest one of a usable window",
        unit="m/s",
        above=0,
    )

    @property
    def defines_map(self) -> bool:
        """Whether the start state is the origin of the map frame, and its heading east."""
        return self.method in ("static", "in_flight")

    @property
    def searches(self) -> bool:
        """Whether the vehicle finds its start state itself, in flight."""
        return self.method in ("in_flight", "map")


@dataclass(frozen=True, slots=True)
class RigConfig(Settings):
    """Uncertainty of the calibration: right camera's attitude and focal length, disparity, and the cameras' clock."""

    flexing: bool = setting(False, "the cameras' relative attitude drifts and vibrates, so it is estimated")
    attitude_sigma_deg: float = setting(
        0.05,
        "flexing: initial error of the attitude's slow part, per axis; best set to twice the expected",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    attitude_walk_deg: float = setting(
        0.001, "flexing: random walk of the attitude's slow part", unit="deg/sqrt(s)", at_least=0, at_most=180
    )
    vibration_sigma_deg: float = setting(
        0.05,
        "flexing: part of the attitude that is independent in each frame, rms per axis",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    rigid_sigma_deg: float = setting(
        2.0e-4,
        "not flexing: error of the attitude about the axis that changes the disparity, if the calibration is right; "
        "0: the attitude is exact about every axis",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    epipolar_sigma_deg: float = setting(
        0.05,
        "not flexing: error of the attitude about the axes that don't change the disparity; each stereo pair shows it",
        unit="deg",
        at_least=0,
        at_most=180,
    )
    disparity_sigma_px: float = setting(
        0.004, "constant error of the disparity, estimated, if the calibration is right; 0: none", unit="px", at_least=0
    )
    miscalibrated_sigma_px: float = setting(
        0.3,
        "not flexing: constant error of the disparity if the calibration is wrong, which the motion shows",
        unit="px",
        above=0,
    )
    miscalibrated_probability: float = setting(
        0.2, "not flexing: probability before the flight that the calibration is wrong; 0: never", at_least=0, below=1
    )
    focal_ratio_sigma: float = setting(
        3.0e-3, "focal length of the right camera over the left one's, relative error, estimated; 0: none", at_least=0
    )
    time_offset_sigma_s: float = setting(
        3.0e-3, "camera clock against IMU clock, estimated; 0: they are equal", unit="s", at_least=0
    )

    def _check_together(self) -> None:
        if 0.0 < self.disparity_sigma_px < LEAST_DISPARITY_SIGMA_PX:
            refuse(
                "disparity_sigma_px", self.disparity_sigma_px, f"0 for none, or at least {LEAST_DISPARITY_SIGMA_PX:g}"
            )
        if self.disparity_sigma_px > self.miscalibrated_sigma_px:
            refuse(
                "miscalibrated_sigma_px",
                self.miscalibrated_sigma_px,
                f"at least disparity_sigma_px, which is {self.disparity_sigma_px:g}",
            )


# No error of the calibration is a state.
EXACT_RIG = RigConfig(rigid_sigma_deg=0.0, disparity_sigma_px=0.0, focal_ratio_sigma=0.0, time_offset_sigma_s=0.0)

# The names in vision.features.EXTRACTORS.
EXTRACTORS = ("sift", "asift", "surf", "dsift", "phow_rgb", "phow_hsv", "phow_opponent", "orb")
SIFT_EXTRACTORS = ("sift", "asift", "dsift")  # with SIFT descriptors of 128 bytes
FRONTEND_METHODS = ("klt", "sift")  # the names in vision.frontends.FRONTENDS
FRONTEND_MATCHERS = (  # gated, and the names in vision.matching.MATCHERS
    "gated",
    "nn",
    "nn_mutual",
    "ransac_homography",
    "ransac_fundamental",
    "gtm",
    "cds_nn",
    "cds_gtm",
)


@dataclass(frozen=True, slots=True)
class FrontendConfig(Settings):
    """Stereo features from image pairs."""

    method: str = setting(
        "klt",
        "klt: points are detected every few frames and tracked; sift: each pair is detected and matched",
        choices=FRONTEND_METHODS,
    )
    extractor: str = setting(
        "sift", "detector and descriptor; dsift and phow_* use a grid, too coarse for a map", choices=EXTRACTORS
    )
    search_scale: float = setting(
        0.25, "klt: factor by which images are shrunk for detection (INTER_AREA)", at_least=0.1, at_most=1
    )
    max_tracks: int = setting(300, "klt: points that are tracked", at_least=1)
    anchored: bool = setting(
        True, "klt: points are tied to how they looked first, and slide far less; takes 1.5 times as long in rooms"
    )
    scale: float = setting(
        0.5, "sift: factor by which images are shrunk for detection (INTER_AREA)", at_least=0.1, at_most=1
    )
    max_features: int = setting(1000, "keypoints kept per image, strongest first", at_least=1, at_most=1_000_000)
    contrast_threshold: float = setting(
        0.01, "SIFT contrast threshold (OpenCV's default 0.04 finds too little on grass)", at_least=0
    )
    matcher: str = setting(
        "gated",
        "sift: left to right; gated: nearest descriptor among those that stereo geometry allows; the others match "
        "whole images, and the geometry is checked afterwards; no effect with klt, which matches by optical flow",
        choices=FRONTEND_MATCHERS,
    )
    ratio: float = setting(
        0.8,
        "nearest / second-nearest descriptor distance: left to right (sift), and between frames at a start in flight",
        above=0,
        at_most=1,
    )
    epipolar_px: float = setting(
        2.0,
        "largest distance to the epipolar line, full-resolution pixels; wider if rig.flexing",
        unit="px",
        above=0,
        live=True,
    )
    min_depth_m: float = setting(0.3, "nearer points are rejected", unit="m", above=0, live=True)
    max_depth_m: float = setting(500.0, "farther points are rejected", unit="m", above=0, live=True)
    max_matches: int = setting(400, "sift: stereo points passed on, spread over the image", at_least=1)

    def _check_together(self) -> None:
        if not self.min_depth_m < self.max_depth_m:
            refuse("min_depth_m", self.min_depth_m, f"a depth below max_depth_m, which is {self.max_depth_m:g}")


FILTERS = ("eif", "ekf", "ukf", "uhf", "thesis_ukf", "thesis_uhf")  # the names in estimation.filters.FILTERS
STATE_MODELS = ("ri15", "so15", "euler9")  # the names in estimation.models.MODELS
# The names in slam.map_manager.RETENTION.
RETENTION_POLICIES = ("grid", "most_observed", "none", "first_last", "largest_covariance")
ASSOCIATIONS = (  # the names in association.ASSOCIATORS
    "gated",
    "gated_classification",
    "classification",
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


@dataclass(frozen=True, slots=True)
class BackendConfig(Settings):
    """The own-only filter and its map."""

    filter: str = setting("eif", "filter", choices=FILTERS)
    model: str = setting(
        "ri15", "state and error coordinates; ri15: right-invariant; euler9: the thesis's", choices=STATE_MODELS
    )
    gamma: float = setting(
        100.0, "bound of uhf and thesis_uhf: smaller is more cautious; uhf raises it where infeasible", above=0
    )
    sigma_px: float = setting(1.0, "standard deviation of each stereo pixel coordinate", unit="px", above=0, live=True)
    depth_sigma_ratio: float = setting(
        0.043, "relief / height, smooths the depth in the Jacobian; 0: off (indoors)", at_least=0
    )
    association: str = setting(
        "gated",
        "data association with landmarks; decides almost nothing with frontend.method klt, whose tracks keep theirs",
        choices=ASSOCIATIONS,
    )
    min_descriptor_ratio: float = setting(
        0.85, "nearest / second-nearest descriptor distance inside the gate", above=0, at_most=1
    )
    gate_probability: float = setting(
        0.99, "that a correct observation passes the chi-square gate of its prediction", above=0, below=1, live=True
    )
    window: int = setting(
        10,
        "past poses in the state: tracks of points that are no landmarks correct them; 0: only landmarks are used",
        at_least=0,
        at_most=60,
    )
    window_spacing_s: float = setting(
        0.03, "least spacing of past poses; those in between are not kept", unit="s", at_least=0
    )
    track_sigma_px: float = setting(
        0.055,
        "window: standard deviation of a tracked point's right pixel about its left one; a track's "
        "other errors are in proportion (klt: 0.04, 0.055 with outliers)",
        unit="px",
        above=0,
        live=True,
    )
    track_noise_from_images: bool = setting(
        True, "window: take the scatter of the tracks about their epipolar lines where it is 1.5 times as large"
    )
    landmark_views: int = setting(
        3, "window: frames that must have shown a track's point to make it a landmark", at_least=2
    )
    robust: bool = setting(
        True, "observations that fit badly after the update are down-weighted (Huber), the update repeated"
    )
    pnp_px: float = setting(4.0, "reprojection error of a PnP inlier", unit="px", above=0)
    redetection_px: float = setting(
        0.0, "standard deviation between two detections of one place, long apart", unit="px", at_least=0
    )
    min_revisited: int = setting(2, "long-unseen landmarks with wide gates are used only if so many agree", at_least=1)
    pnp_beyond_px: float = setting(
        8.0,
        "PnP checks the matches when the median predicted 1-sigma is wider than this; 0: always",
        unit="px",
        at_least=0,
    )
    max_observations: int = setting(100, "updates a frame, spread over the image", at_least=1, live=True)
    max_new_landmarks: int = setting(40, "landmarks added a frame", at_least=0)
    max_in_view: int = setting(120, "with so many landmarks in view no new ones are added", at_least=1)
    max_landmarks: int = setting(200, "landmarks in the state, retained ones included", at_least=1)
    retention: str = setting("grid", "which landmarks out of view are kept", choices=RETENTION_POLICIES)
    retention_cell_m: float = setting(25.0, "grid: one retained landmark per cell of this size", unit="m", above=0)

    def _check_together(self) -> None:
        if self.max_landmarks < self.max_in_view:
            refuse("max_landmarks", self.max_landmarks, f"at least max_in_view, which is {self.max_in_view}")


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
        above=0,
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
        "data association with peers' landmarks; consistent: by descriptor, gate and pairwise consistency; the others "
        "need common_origin",
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
        "", "shared secret of the fleet, 16 bytes or more: packets without its tag are dropped"
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


@dataclass(frozen=True, slots=True)
class OutputFramesConfig(Settings):
    """Names of the frames that the nodes publish (REP-105); that of the body is `input.frames.base`."""

    world: str = setting(
        "",
        "frame of the fused estimate; empty: world, which the fleet shares, or VEHICLE/world without a common origin",
    )
    map: str = setting("", "frame of the vehicle's own map; empty: VEHICLE/map")
    odom: str = setting("", "frame in which the own pose has no jumps; empty: VEHICLE/odom")

    def map_of(self, vehicle: str) -> str:
        """Return the name of a vehicle's map frame."""
        return self.map or f"{vehicle}/map"


@dataclass(frozen=True, slots=True)
class VehicleConfig(Settings):
    """Everything that one vehicle's nodes, or its offline twin, need besides calibration and start state."""

    input: InputConfig = field(default_factory=InputConfig)
    frames: OutputFramesConfig = field(default_factory=OutputFramesConfig)
    start: StartConfig = field(default_factory=StartConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    rig: RigConfig = field(default_factory=RigConfig)
    frontend: FrontendConfig = field(default_factory=FrontendConfig)
    backend: BackendConfig = field(default_factory=BackendConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)

    def _check_together(self) -> None:
        if self.start.map and self.fusion.prior_id:
            refuse("fusion.prior_id", self.fusion.prior_id, "none beside start.map: the map's own hash is used")
        if self.fusion.mode == "narrowband" and self.frontend.extractor not in SIFT_EXTRACTORS:
            allowed = f"one of {', '.join(SIFT_EXTRACTORS)} in narrowband mode, whose descriptors are made of SIFT's"
            refuse("frontend.extractor", self.frontend.extractor, allowed)
