# SPDX-License-Identifier: Apache-2.0
import math

import pytest

from uav_vslam.config import FrontendConfig, VehicleConfig
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.flights import TRACKS, Method, Outcome, _rows, run_study, with_backend

SHORT = Scenario(frames=25)
FIELDS = {
    "method",
    "condition",
    "end_rms_m",
    "ate_rms_m",
    "ratio_to_s_slam",
    "end_ratio_to_ins",
    "nees_position",
    "processed_share",
    "failures",
    "runs",
    "ms_per_frame",
}


@pytest.fixture(scope="module")
def rows():
    methods = [
        Method("ri15", "landmarks", SHORT),
        Method("euler9", "landmarks", SHORT, with_backend(VehicleConfig(), model="euler9")),
    ]
    return run_study(methods, [1, 2], workers=1)


def test_each_track_has_a_row_and_the_ins_only_one(rows):
    assert [row["method"] for row in rows] == ["INS", "S-SLAM ri15", "C-SLAM ri15", "S-SLAM euler9", "C-SLAM euler9"]
    assert all(set(row) == FIELDS for row in rows)


def test_ratios_belong_to_their_own_method(rows):
    ins, own, fused = rows[:3]
    assert math.isclose(own["end_ratio_to_ins"], own["end_rms_m"] / ins["end_rms_m"])
    assert math.isclose(fused["ratio_to_s_slam"], fused["ate_rms_m"] / own["ate_rms_m"])
    assert rows[3]["ratio_to_s_slam"] == 1.0


def test_ratio_and_nees_have_their_interval_over_the_seeds():
    method = Method("ri15", "landmarks", SHORT)

    def outcome(seed: int, fused_m: float, nees: float) -> Outcome:
        tracks = {"ins": {"ate_m": 9.0}, "s_slam": {"ate_m": 2.0}, "c_slam": {"ate_m": fused_m, "nees_position": nees}}
        return Outcome(method, seed, {name: {"uav1": of} for name, of in tracks.items()}, ms_per_frame=1.0)

    outcomes = [outcome(1, 1.0, 0.5), outcome(2, 1.6, 0.5), outcome(3, 1.0, 2.0)]
    ins, _, fused = _rows(method, outcomes, TRACKS)
    assert (fused["ratio_low"], fused["ratio_high"]) == pytest.approx((0.5, 0.8))  # all draws of one seed
    assert (fused["nees_position_low"], fused["nees_position_high"]) == pytest.approx((0.5, 2.0))
    assert "nees_position_low" not in ins


def test_every_frame_is_processed_and_nothing_fails(rows):
    assert all(row["processed_share"] == 1.0 and row["failures"] == 0 for row in rows)


def test_rendered_images_are_searched_once_for_both_inertial_grades(monkeypatch):
    from uav_vslam.vision.stereo_points import StereoFrontend

    searched = []
    detect = StereoFrontend.detect
    monkeypatch.setattr(StereoFrontend, "detect", lambda self, frame: (searched.append(1), detect(self, frame))[1])
    small = {"frames": 3, "vehicles": 1, "scale": 0.25}
    config = VehicleConfig(frontend=FrontendConfig(method="sift"))
    grades = ("adis16480", "consumer")
    methods = [Method("ri15", imu, Scenario(imu=imu, **small), config, rendered=True) for imu in grades]
    rows = run_study(methods, [1], workers=1)
    assert len(searched) == 3
    assert {row["condition"] for row in rows} == {"adis16480", "consumer"}
