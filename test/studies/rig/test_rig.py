# SPDX-License-Identifier: Apache-2.0
"""Every condition is what its name says, and both methods fly the very same pixels."""

import math

import numpy as np
import pytest

from uav_vslam.config import load_vehicle
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.studies.engine.variants import CALIBRATIONS
from uav_vslam.studies.rig.compute import RIGID, conditions, run_study
from uav_vslam.vision.stereo_points import StereoFrontend

pytestmark = pytest.mark.slow

TINY = Scenario(frames=3, vehicles=1, scale=0.25)
SIFT = {"frontend.method": "sift"}  # which looks without regard to the rig, so that both methods can share what it saw
CONFIGS = {name: load_vehicle(None, overrides=keys | SIFT) for name, keys in CALIBRATIONS.items()}
FIXED, ESTIMATED, DISPARITY = CONFIGS


@pytest.fixture(scope="module")
def searched() -> list[int]:
    """Stamps of the pairs that the front end was given in the study."""
    return []


@pytest.fixture(scope="module")
def rows(searched):
    detect = StereoFrontend.detect
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StereoFrontend, "detect", lambda self, f: (searched.append(f.stamp_ns), detect(self, f))[1])
        return run_study(TINY, CONFIGS, [1], workers=1)


def test_the_right_camera_is_turned_as_the_condition_says():
    turned = {name: np.rad2deg(simulate_vehicle(c, 0).right_rotations) for name, c in conditions(Scenario()).items()}
    assert len(turned) == 11
    np.testing.assert_array_equal(turned[RIGID], 0.0)
    np.testing.assert_allclose(turned["bias 0.02 deg about x (disparity)"], [[0.02, 0.0, 0.0]] * 160)
    np.testing.assert_allclose(turned["bias 0.05 deg about z (optical)"], [[0.0, 0.0, 0.05]] * 160)
    for rms in (0.02, 0.05):
        drawn = turned[f"vibration {rms} deg"]
        assert np.sqrt(np.mean(drawn**2)) == pytest.approx(rms, rel=0.15)  # 480 draws: 3 % of standard deviation
        assert not np.array_equal(drawn[0], drawn[1])


def test_x_is_the_axis_that_changes_disparity():
    scenario = conditions(Scenario(frames=2))
    point = np.array([[0.0, 0.0, 70.0]])  # below the left camera [m]
    shifts = []
    for name in "xyz":
        (condition,) = (c for key, c in scenario.items() if key.startswith(f"bias 0.05 deg about {name}"))
        vehicle = simulate_vehicle(condition, 0)
        shifts.append((vehicle.true_rig(0).project(point) - vehicle.rig.project(point))[0, 2:])
    along_u, along_v = np.abs(shifts).T
    whole = 1646.0 * math.radians(0.05)  # of the right camera's focal length [px]
    np.testing.assert_allclose([along_v[0], along_u[1]], whole, rtol=0.05)
    assert max(along_u[0], along_v[1], along_u[2], along_v[2]) < 0.1 * whole


def test_the_methods_differ_in_what_is_estimated():
    assert [config.rig.flexing for config in CONFIGS.values()] == [False, True, False]
    assert [config.rig.miscalibrated_probability for config in CONFIGS.values()] == [0.2, 0.2, 0.5]


def test_a_disparity_error_shifts_only_the_right_points_along_the_disparity():
    vehicle = simulate_vehicle(conditions(Scenario(frames=2))["disparity error 0.3 px"], 0)
    point = np.array([[3.0, -2.0, 70.0]])
    shift = (vehicle.true_rig(0).project(point) - vehicle.rig.project(point))[0]
    np.testing.assert_allclose(np.abs(shift), [0.0, 0.0, 0.0, 0.3], rtol=0, atol=0.01)  # of Kagaru's rig: in v


def test_the_ins_has_one_row_and_each_condition_one_for_each_method(rows):
    names = [(row["condition"], row["method"]) for row in rows]
    assert names[:3] == [("any", "INS"), (RIGID, f"S-SLAM, {FIXED}"), (RIGID, f"S-SLAM, {ESTIMATED}")]
    assert [condition for condition, _ in names[1::3]] == list(conditions(TINY))
    assert len(names) == len(set(names)) == 34


def test_end_errors_are_told_as_multiples_of_the_rigid_rigs(rows):
    rigid = rows[1]["end_rms_m"]
    assert rows[1]["end_ratio_to_rigid"] == 1.0
    assert all(row["end_ratio_to_rigid"] == row["end_rms_m"] / rigid for row in rows)


def test_each_look_is_searched_once_for_both_methods(rows, searched):
    assert rows
    assert len(searched) == 11 * TINY.frames


def test_every_frame_is_processed_and_nothing_fails(rows):
    assert all(row["processed_share"] == 1.0 and row["failures"] == 0 for row in rows[1:])
