# SPDX-License-Identifier: Apache-2.0
"""The own-only filter and its map."""

from dataclasses import dataclass

from uav_vslam.config.settings import Settings, refuse, setting

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
        "ri15",
        "state and error coordinates; ri15: right-invariant; euler9: the thesis's, over-confident by far",
        choices=STATE_MODELS,
    )
    gamma: float = setting(
        100.0,
        "bound of uhf and thesis_uhf: smaller is more cautious; where infeasible, uhf raises it, and "
        "thesis_uhf is over-confident",
        at_least=0.1,
    )
    sigma_px: float = setting(
        1.0, "standard deviation of each raw stereo pixel coordinate", unit="px", at_least=0.01, live=True
    )
    depth_sigma_ratio: float = setting(
        0.043,
        "relief / depth of the ground, to which the depth in the Jacobian is smoothed where points show it; 0: off",
        at_least=0,
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
        "past poses in the state: tracks of points that are no landmarks correct them; 0: only landmarks are used, and "
        "each is linearised about its first view",
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
        at_most=1000,
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
    redetection_px: float = setting(  # seen by the closures of `uav-vslam study revisit`
        0.7, "standard deviation between two detections of one place, long apart", unit="px", at_least=0
    )
    chance_revisits: float = setting(
        0.05,
        "long-unseen landmarks with wide gates are used only in a group of which fewer are expected to agree by chance",
        at_least=0,
    )
    pnp_beyond_px: float = setting(
        8.0,
        "PnP checks the matches when the median predicted 1-sigma is wider than this; 0: always",
        unit="px",
        at_least=0,
    )
    max_observations: int = setting(
        100,
        "landmarks that correct a frame, spread over the image; the window's tracks correct it besides",
        at_least=1,
        live=True,
    )
    max_new_landmarks: int = setting(40, "landmarks added a frame", at_least=0)
    max_in_view: int = setting(120, "with so many landmarks in view no new ones are added", at_least=1)
    max_landmarks: int = setting(200, "landmarks in the state, retained ones included", at_least=1)
    retention: str = setting("grid", "which landmarks out of view are kept", choices=RETENTION_POLICIES)
    retention_cell_m: float = setting(25.0, "grid: one retained landmark per cell of this size", unit="m", above=0)

    def _check_together(self) -> None:
        if self.max_landmarks < self.max_in_view:
            refuse("max_landmarks", self.max_landmarks, f"at least max_in_view, which is {self.max_in_view}")
