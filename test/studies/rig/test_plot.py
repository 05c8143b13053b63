# SPDX-License-Identifier: Apache-2.0
import cv2
import pytest

from uav_vslam.report.style import STYLES
from uav_vslam.studies.rig.plot import draw_rig, rig_plot

CONDITIONS = ("rigid", "vibration 0.05 deg")
METHODS = ("S-SLAM, fixed", "S-SLAM, estimated")


@pytest.fixture
def rows():
    ins = {"condition": "any", "method": "INS", "end_rms_m": 30.0}
    figures = {("rigid", 0): 1.0, ("rigid", 1): 1.1, ("vibration 0.05 deg", 0): 25.0, ("vibration 0.05 deg", 1): 1.2}
    return [
        ins,
        *(
            {"condition": condition, "method": METHODS[k], "end_rms_m": end, "nees_position": 2.0 * end}
            for (condition, k), end in figures.items()
        ),
    ]


def marks(axes, name):
    (line,) = [line for line in axes.lines if line.get_label() == name]
    return line.get_xydata().tolist()


def test_each_method_has_a_mark_a_condition(rows):
    errors, nees = rig_plot(rows).axes
    assert marks(errors, METHODS[0]) == [[1.0, 0.0], [25.0, 1.0]]
    assert marks(errors, METHODS[1]) == [[1.1, 0.0], [1.2, 1.0]]
    assert marks(nees, METHODS[1]) == [[2.2, 0.0], [2.4, 1.0]]
    assert [label.get_text() for label in errors.get_yticklabels()] == list(CONDITIONS)
    assert errors.get_xscale() == nees.get_xscale() == "log"


def test_any_number_of_methods_is_drawn(rows):
    errors, _ = rig_plot([{**row, "method": f"S-SLAM, {k}"} for k in range(5) for row in rows[1:2]]).axes
    assert [marks(errors, f"S-SLAM, {k}") for k in range(5)] == [[[1.0, 0.0]]] * 5


def test_the_ins_is_a_line_and_no_condition(rows):
    errors, _ = rig_plot(rows).axes
    (line,) = [line for line in errors.lines if line.get_color() == STYLES["ins"].colour]
    assert set(line.get_xdata()) == {30.0}


def test_where_every_run_failed_there_is_no_line_of_the_ins(rows):
    failed = [{**row, "end_rms_m": None, "nees_position": None} for row in rows]
    errors, _ = rig_plot(failed).axes
    assert not [line for line in errors.lines if line.get_color() == STYLES["ins"].colour]


def test_a_method_that_failed_everywhere_leaves_a_gap(rows):
    rows[3] |= {"end_rms_m": None, "nees_position": None}
    errors, _ = rig_plot(rows).axes
    assert len(marks(errors, METHODS[0])) == 2
    assert marks(errors, METHODS[0])[0] == [1.0, 0.0]


def test_the_study_is_drawn_to_a_readable_picture(rows, tmp_path):
    (path,) = draw_rig({"rows": rows}, tmp_path)
    picture = cv2.imread(str(path))
    assert path.name == "rig.png"
    assert min(picture.shape[:2]) > 300
    assert picture.std() > 5
