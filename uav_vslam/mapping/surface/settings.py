# SPDX-License-Identifier: Apache-2.0
"""How pairs of images are chosen and matched."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SurfaceSettings:
    """Settings of motion stereo; lengths that depend on the flying height are ratios to the height above ground.

    Attributes:
        scale: of the images in which disparities are searched.
        baseline_ratio: baseline over height of a pair; the first view that is this far back is the partner.
        longest_ratio: beyond it, perspectives differ too much.
        step_ratio: distance between pairs over height.
        short_ratios: shorter baselines for ground that few views show: of banked ones, the first and the last.
        missing_share: of a view's ground that is left over by other pairs and worth one of those.
        largest_turn_deg: between the optical axes of a pair.
        least_overlap: of the views, as a share of the smaller one's ground.
        above_m, below_m: of the surface last seen, by which the searched depths reach beyond it.
        highest_ratio: of the searched depths' highest surface over the height.
        most_disparities: that are searched; a longer range is cut at its far end.
        match_px: least standard deviation of a disparity in the scaled images, pixel locking included.
        relative_position_m, relative_attitude_rad: standard deviations of the motion between the views of a pair.
    """

    scale: float = 0.5
    baseline_ratio: float = 0.2
    longest_ratio: float = 0.4
    step_ratio: float = 0.1
    short_ratios: tuple[float, ...] = (0.12, 0.06, 0.03)
    missing_share: float = 0.01
    largest_turn_deg: float = 25.0
    least_overlap: float = 0.3
    above_m: float = 8.0
    below_m: float = 4.0
    highest_ratio: float = 0.7
    most_disparities: int = 160
    match_px: float = 0.15
    relative_position_m: float = 0.004
    relative_attitude_rad: float = 5e-5
