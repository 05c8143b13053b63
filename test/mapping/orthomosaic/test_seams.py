# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from flown_scene import Scene, moved, patches

from uav_vslam.mapping.orthomosaic import Orthomosaic
from uav_vslam.mapping.orthomosaic.seams import seams

SCENE = Scene(colour=patches(0.3))
VIEWS = [SCENE.view((x, 0.0, 30.0), stamp_ns=round(x)) for x in (0.0, 9.0)]


@pytest.mark.parametrize("error_m", [0.0, 0.3, -0.12])
def test_a_wrong_pose_shows_as_the_shift_across_its_seam(error_m: float) -> None:
    views = [VIEWS[0], moved(VIEWS[1], error_m)]
    mosaic = Orthomosaic(SCENE, 0.1)
    for view in views:
        mosaic.add(view)
    found = seams(mosaic, mosaic.picture(), views)
    assert len(found.points) >= 3
    np.testing.assert_allclose(found.points[:, 0], 4.5, atol=0.5)
    np.testing.assert_allclose(found.shifts_px, np.tile([error_m / 0.1, 0.0], (len(found.points), 1)), atol=0.15)
    assert found.figures()["median_px"] == pytest.approx(abs(error_m) / 0.1, abs=0.12)
    assert found.figures()["p90_step"] < 0.02


def test_one_view_has_no_seam() -> None:
    mosaic = Orthomosaic(SCENE, 0.1)
    mosaic.add(VIEWS[0])
    found = seams(mosaic, mosaic.picture(), VIEWS)
    assert len(found.points) == 0
    assert np.isnan(found.figures()["median_px"])
