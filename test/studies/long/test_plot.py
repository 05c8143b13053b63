# SPDX-License-Identifier: Apache-2.0
"""The long flight's plot shows each policy over the distance."""

import numpy as np

from uav_vslam.studies.long.plot import draw_long, long_plot, running_median

LONG = [
    {
        "method": name,
        "distance_m": [0.0, 3.0, 6.0],
        "error_m": [0.0, e, e],
        "ms_per_frame": [9.0, 9.0, 9.0],
        "landmarks": [40.0] * 3,
    }
    for name, e in (("grid", 0.5), ("none", 1.5))
]


def test_what_there_is_becomes_readable_pictures(drawn):
    assert drawn(draw_long, {"rows": [], "series": LONG}) == ["long.png"]
    assert drawn(draw_long, {"rows": []}) == []


def test_the_long_flight_has_error_time_and_landmarks_over_distance():
    errors, times, landmarks = long_plot(LONG).axes
    np.testing.assert_array_equal(errors.lines[1].get_xydata(), [[0.0, 0.0], [3.0, 1.5], [6.0, 1.5]])
    assert [line.get_ydata()[0] for line in (*times.lines, *landmarks.lines)] == [9.0, 9.0, 40.0, 40.0]
    assert landmarks.get_xlabel() == "Distance flown [m]"


def test_a_single_slow_frame_is_not_seen_in_the_running_median():
    values = np.full(50, 8.0)
    values[[0, 20, 49]] = 100.0
    np.testing.assert_array_equal(running_median(values), np.full(50, 8.0))
