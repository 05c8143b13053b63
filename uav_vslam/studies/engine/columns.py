# SPDX-License-Identifier: Apache-2.0
"""The columns of every study's tables: the same quantity has the same key everywhere, and its unit in the name.

A row names its `method` and its `condition`. Its figures are those of the track that the method computes; the prefix
`s_slam_` or `c_slam_` marks a figure of the own-only or of the fused track of the same flights. Shares and ratios have
no unit; `_worst`, `_max` and `_mean` are over the runs.
"""

from collections.abc import Sequence

from uav_vslam.evaluation.study import TABLE, Row

IDENTITY = ("method", "condition")
COLUMNS: dict[str, str] = {
    # which
    TABLE: "heading of the row's table",
    "method": "the compared method, setting, stage or process",
    "condition": "flight, noise, images, start",
    "seed": "of the row's single run",
    "channel": "content sent over the radio",
    "extractor": "whose noise is simulated",
    "kind": "of wrong match",
    "wrong_match_share": "of the matches that are simulated wrong",
    "camera": "still or moving",
    "spacing": "number of images from the first to the second",
    "descriptor_ratio": "largest ratio of nearest to second-nearest descriptor distance",
    "reference": "timed alternately with it",
    # errors, root mean square over the runs
    "ate_rms_m": "position error over the flight",
    "ate_start_yaw_rms_m": "the same after the best turn about the vertical through the start",
    "ate_se3_rms_m": "the same after the best rigid alignment",
    "ate_yaw_aligned_rms_m": "the same after the best turn about the vertical and the best shift",
    "ate_mean_m": "mean of the runs' ATE",
    "ate_worst_m": "largest ATE of a run",
    "end_rms_m": "position error at the end",
    "error_max_m": "largest position error of a frame",
    "height_rms_m": "error of the height over the flight",
    "height_step_m": "largest change of the height's error from frame to frame",
    **{
        f"rpe_{length_m}m_{what}": f"relative error over {length_m} m of the path, {text}"
        for length_m in (14, 100)
        for what, text in {
            "along_m": "along it",
            "across_m": "across it",
            "height_m": "in height",
            "attitude_mrad": "angle of the rotation",
        }.items()
    },
    # heights of a map
    "height_median_m": "error of the map's height over open ground, own error removed, median",
    "height_95_m": "the same, 95 %",
    "height_level_median_m": "the same with one constant removed, median",
    "height_level_95_m": "the same with one constant removed, 95 %",
    "standing_median_m": "error of the height over everything that stands, median",
    "barn_edge_m": "distance of the barns' edges from the true ones, median",
    "coverage_share": "of the cells that an image shows",
    "absolute_median_m": "error of the map's height over open ground, nothing removed, median",
    "own_height_median_m": "error of the height of the poses, median",
    "nees_height": "squared error of the height over the claimed variance, mean",
    "drift_before_rms_m": "position error before the loop is closed",
    "rer": "relative error rate of the thesis, SLAM over INS",
    **{f"rer_w{k}": f"the same under noise scale w{k}" for k in range(1, 5)},
    # ratios of errors
    "ratio_to_s_slam": "ATE over that of the same vehicles alone",
    "ratio_low": "bootstrap interval of the row's ratio, lower end",
    "ratio_high": "and upper end",
    "ratio_to_plain": "ATE over that of the same flights in a conventional recording",
    "ratio_to_plain_least": "the smallest of a run",
    "ratio_to_plain_most": "the largest of a run",
    "lasting_ratio_to_s_slam": "ratio_to_s_slam long after the last common view",
    "end_ratio_to_ins": "end error over the INS's",
    "end_ratio_to_batch": "end error over the batch optimum's",
    "end_ratio_to_rigid": "end error over the first method's with a rigid rig",
    "end_ratio_to_clean": "end error over that without wrong matches",
    "ratio_to_exact": "ATE over that of the same flights with the exact calibration",
    "end_ratio_to_forgetting": "end error over that with nothing retained",
    "better_ate_rms_m": "ATE of the vehicle of each seed that is better alone",
    "better_ratio_to_s_slam": "its ratio_to_s_slam",
    "gain_kept_share": "of the gain in wideband",
    # consistency: 1 is consistent, more over-confident
    "nees_position": "NEES of the position over 3, mean",
    "nees_position_end": "the same at the end",
    "nees_position_worst": "the same, worst run",
    "nees_position_low": "bootstrap interval of the mean over seeds, lower end",
    "nees_position_high": "and upper end",
    "nees_position_worst_quarter": "the largest mean of a quarter of the flight",
    "nees_position_outside": "share of runs whose mean over time is outside of the chi-square band of one NEES",
    "nees_rotation": "NEES of the rotation over 3, mean",
    "nees_rotation_worst": "the same, worst run",
    "nees_frame": "NEES of the peer's frame over 4, mean",
    "lambda_excess": "largest eigenvalue of R^-1 P over all packets, less 1: above 0 a packet is over-confident",
    "largest_jump_sigmas": "largest step of the correction from frame to frame over the fused sigma",
    # runs and their outcomes
    "runs": "number of runs",
    "failures": "runs that failed",
    "failure": "why the run ended early",
    "restarts": "re-initialisations of the filter, sum over the runs",
    "frames": "number of frames",
    "processed_share": "of the frames",
    "frames_coasted": "frames with no associated landmark, on the INS alone",
    "frames_coasted_worst": "the same of the worst run",
    "recovered_frames": "from the fault's end until many landmarks are associated, worst run",
    "alarms": "reports of the diagnostics and their number of frames",
    "found": "runs that found it",
    "good": "runs that found it in time and well",
    "settled": "runs that settled in time",
    "settled_to_start": "the same, with the map's own heading and drift in the error",
    "settled_worst_s": "time until the last one settled",
    "warned": "runs in which the start monitor warned",
    "closed": "runs with a right loop closure",
    "closures": "landmarks re-observed after a long time, per run",
    "false_closures": "wrong ones among them, sum over the runs",
    # legs of one flight
    "leg_start_s": "of the leg in the recording",
    "leg_end_s": "of the leg in the recording",
    "overlap": "share of a view that the other leg's best view sees, mean",
    "overlapping_views": "share of the views that share a tenth or more; the medians are over these",
    "heading_difference_deg": "between such views, median",
    "view_difference_deg": "between the directions in which common points are seen, median",
    "passes_apart_s": "between such views in the recording, median",
    # time and memory
    "ms_per_frame": "processor time of the method",
    "ms_front_end": "processor time of the front end for a frame",
    "ms_per_frame_early": "the same early in the flight",
    "ms_per_frame_late": "and late in it",
    "late_to_early": "ratio of the two",
    "ms_association": "the associator's share of it",
    "ms_per_pair": "of images",
    "ms_per_epoch": "of fusion, packet included",
    "ms_per_packet": "processor time",
    "us_per_landmark": "processor time",
    "mb_per_s": "read",
    "ratio_to_reference": "of the times",
    "core_share": "of one processor core",
    "growth_mb": "memory gained over the flight",
    "extract_s": "processor time, both images",
    "match_s": "processor time",
    "ransac_s": "processor time",
    # landmarks and features
    "landmarks": "in the state, or shared",
    "landmarks_mean": "in the state",
    "landmarks_max": "in the state",
    "points_per_frame": "accepted stereo points",
    "kept_share": "points over those with equal cameras",
    "followed_share": "points seen in an earlier frame too",
    "sigma_px": "standard deviation of the right pixel",
    "beyond_1px_share": "right pixels that far off",
    "keypoints_1": "of the first image",
    "keypoints_2": "of the second image",
    "matches": "without RANSAC",
    "matches_ransac": "kept by RANSAC",
    "rate_1": "matches over keypoints_1",
    "rate_2": "matches over keypoints_2",
    "rate_1_ransac": "matches_ransac over keypoints_1",
    "rate_2_ransac": "matches_ransac over keypoints_2",
    "precision": "share of the pairs that are right",
    "precision_ransac": "the same after RANSAC",
    "recall": "share of the possible pairs that were found",
    "error_median_px": "of the right matches",
    "pairs": "of landmarks",
    "pairs_per_frame": "of landmark and feature",
    # packets
    "sent_bytes_per_s": "payload of a vehicle, mean",
    "sent_bytes_per_s_max": "the same, largest",
    "packet_bytes_max": "payload of the largest packet",
    "packets_sent": "sum",
    "packets_received": "sum",
    "packets_used": "sum",
    "packets_dropped": "by reason",
    "recovery_packets": "sent after the blackout until one was used",
    "measured": "measured value",
    "limit": "required value",
    "met": "yes or no",
    # the peer's frame
    "wrong_share": "of the matches in the packet that gives the frame",
    "wrong": "matches among them",
    "used": "inlier matches of the alignment",
    "wrong_used": "wrong ones among those",
    "found_s": "time until the frame was found",
    "found_median_s": "the same, median",
    "error_m": "of the frame when it was found",
    "error_deg": "the same",
    "error_median_m": "the same, median",
    "error_worst_m": "the same, worst run",
    "error_worst_deg": "the same, worst run",
    "later_rms_m": "error of the frame from then on",
    "later_rms_deg": "the same",
    "weighted_m": "error_m against the weighted fit",
    "weighted_worst_m": "the same, worst run",
    "true_m": "error_m against the true frames",
    "true_deg": "the same",
    "true_worst_m": "the same, worst run",
    "true_worst_deg": "the same, worst run",
    # pictures of the ground
    "place_rms_m": "distance between where the picture shows ground and where it is",
    "place_worst_m": "the same, worst run",
    "place_start_yaw_rms_m": "that distance after the best rotation about the flight's start",
    "place_rigid_rms_m": "that distance after the best rigid motion in the plane",
    "place_rigid_worst_m": "the same, worst run",
    "found_share": "of the patches, found in the true picture",
    "brightness_spread": "standard deviation of the patches' brightness over the truth's",
    "seam_median_px": "shift of the views that meet at a seam, in pixels of the picture, median",
    "seam_p90_px": "the same, 90th percentile",
    "seam_step": "step of their brightness, share, median",
    "key_frames": "views that the picture is made of",
    "ms_per_key_frame": "processor time of one, without mapping the surface",
    # the estimated start
    "start_velocity_rms_m_per_s": "error",
    "start_tilt_rms_deg": "error",
    # the thesis's conclusions
    "verdict": "whether our figures agree",
    "figures": "on which the verdict is based",
}
TRACKS = ("s_slam_", "c_slam_", "gtsam_")


def check_rows(rows: Sequence[Row]) -> None:
    """Check that every row has its labels, and that its columns are declared.

    Raises:
        ValueError: a label is missing, or a column is not declared.
    """
    for row in rows:
        missing = [key for key in IDENTITY if not isinstance(row.get(key), str)]
        unknown = [key for key in row if _plain(key) not in COLUMNS]
        if missing or unknown:
            raise ValueError(
                f"row {row}: no text under {missing}, not in COLUMNS: {unknown}; see studies.engine.columns"
            )


def legend(rows: Sequence[Row]) -> str:
    """Return what the figures of the rows mean."""
    used = dict.fromkeys(_plain(key) for row in rows for key in row if key not in (TABLE, *IDENTITY))
    return "; ".join(f"{key}: {COLUMNS[key]}" for key in used)


def _plain(key: str) -> str:
    """Return a key without the track's name before it."""
    return next((key.removeprefix(track) for track in TRACKS if key.startswith(track)), key)
