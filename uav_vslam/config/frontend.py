# SPDX-License-Identifier: Apache-2.0
"""Stereo features from image pairs."""

from dataclasses import dataclass

from uav_vslam.config.settings import Settings, refuse, setting

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
        "sift",
        "detector and descriptor; dsift and phow_* use a grid, too coarse for a map; asift takes 40 times as long as "
        "sift, over 20 s an image of 1280x960",
        choices=EXTRACTORS,
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
        "largest distance to the epipolar line, full-resolution raw pixels; wider if rig.flexing",
        unit="px",
        above=0,
        live=True,
    )
    min_depth_m: float = setting(0.3, "nearer points are rejected", unit="m", above=0, live=True)
    max_depth_m: float = setting(
        500.0, "points farther by more than disparity noise are rejected", unit="m", above=0, live=True
    )
    max_matches: int = setting(400, "sift: stereo points passed on, spread over the image", at_least=1)

    def _check_together(self) -> None:
        if not self.min_depth_m < self.max_depth_m:
            refuse("min_depth_m", self.min_depth_m, f"a depth below max_depth_m, which is {self.max_depth_m:g}")
