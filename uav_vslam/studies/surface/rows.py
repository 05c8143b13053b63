# SPDX-License-Identifier: Apache-2.0
"""Tables of the surfaces and of the poses they were made with."""

from collections.abc import Sequence

from uav_vslam.evaluation.study import TABLE, Row
from uav_vslam.evaluation.summary import TRACK_NAMES
from uav_vslam.studies.engine.pool import mean, rms
from uav_vslam.studies.engine.score_columns import values_of
from uav_vslam.studies.surface.compute import MappedSeed

POSE_KEYS = {
    "ate_rms_m": "ate_m",
    "height_rms_m": "height_rms_m",
    **{f"rpe_14m_{what}": f"rpe_14m_{what}" for what in ("along_m", "across_m", "height_m", "attitude_mrad")},
}


def surface_rows(found: Sequence[MappedSeed]) -> list[Row]:
    """Return a row for each method and kind of poses: means over the seeds."""
    rows: list[Row] = []
    for method, kind in found[0].surfaces:
        scores = [seed.surfaces[method, kind] for seed in found]
        row: Row = {TABLE: "Surfaces", "method": method, "condition": f"{kind} poses", "runs": len(found)}
        rows.append(row | {key: mean(values_of(scores, key)) for key in scores[0]})
    return rows


def pose_rows(found: Sequence[MappedSeed]) -> list[Row]:
    """Return a row for each kind of poses: root mean squares over seeds and vehicles."""
    rows: list[Row] = []
    for kind in found[0].poses:
        scores = [score for seed in found for score in seed.poses[kind]]
        row: Row = {TABLE: "Poses", "method": TRACK_NAMES.get(kind, kind), "condition": "rendered images"}
        rows.append(row | {key: rms(values_of(scores, name)) for key, name in POSE_KEYS.items()})
    return rows
