# SPDX-License-Identifier: Apache-2.0
"""The revisit's plot shows error over distance, and each flight's end over that with nothing retained."""

import numpy as np

from uav_vslam.studies.revisit.plot import draw_revisit, revisit_plot

REVISIT = [
    {
        "method": name,
        "condition": level,
        "distance_m": [0.0, 1000.0, 2000.0],
        "error_m": [0.0, 2.0, e],
        "seeds": seeds,
        "ends_m": [e + seed for seed in seeds],
    }
    for level in ("landmark", "rendered")
    for name, e, seeds in (("retained", 0.5, [1, 2]), ("nothing retained", 1.5, [2]))
]


def test_what_there_is_becomes_readable_pictures(drawn):
    assert drawn(draw_revisit, {"rows": [], "series": REVISIT}) == ["revisit.png"]
    assert drawn(draw_revisit, {"rows": []}) == []


def test_each_flights_end_stands_over_its_end_without_retention():
    errors, ends, *of_rendered = revisit_plot(REVISIT).axes
    np.testing.assert_array_equal(errors.lines[1].get_ydata(), [0.0, 2.0, 1.5])
    assert ends.lines[0].get_xydata().tolist() == [[3.5, 2.5]]  # seed 1 has no other end to stand over
    assert [line.get_ydata()[1] / line.get_xdata()[1] for line in ends.lines[1:]] == [1.0, 0.5]
    assert len(of_rendered) == 2


def test_more_variants_than_colours_are_all_drawn():
    curves = [REVISIT[0] | {"method": f"variant {number}"} for number in range(9)] + [REVISIT[1]]
    errors, ends = revisit_plot(curves).axes
    assert len(errors.lines) == 10
    assert len(ends.lines) == 9 + 2
