# SPDX-License-Identifier: Apache-2.0
"""Two vehicles with unknown map transform: when it is found, and how the result is scored."""

import pytest

from uav_vslam.config import FUSION_ASSOCIATIONS
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.association_stages import STAGES, UNKNOWN_FRAME
from uav_vslam.studies.engine.separate_frames import OwnOnlyTracks, fly_own_only
from uav_vslam.studies.frames.compute import OWN, PEER, TRACKS, run_together

pytestmark = pytest.mark.slow

FRAMES = 36  # five seconds


@pytest.fixture(scope="module")
def flown() -> OwnOnlyTracks:
    return fly_own_only(Scenario(seed=1, frames=FRAMES))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_vehicles_find_each_others_maps(flown: OwnOnlyTracks, share: float) -> None:
    run = run_together(flown, 1, share, feedback=True)
    assert run.first is not None
    assert run.first.after_s < 5.0
    assert run.first.used.wrong == 0
    assert run.first.used.left >= 8
    assert run.errors[0, 0] < 1.5
    assert run.errors[0, 1] < 1.0
    assert run.first.to_weighted[0] < 0.5  # by the same landmarks but for a few
    assert run.first.to_true[0] < 2.0
    assert run.first.nees < 5.0
    assert (run.first.matches.wrong > 0) == (share > 0)


def test_a_run_is_judged_in_every_respect(flown: OwnOnlyTracks) -> None:
    run = run_together(flown, 1, 0.3)
    assert run.share == 0.3
    assert set(run.stages) == {*STAGES, UNKNOWN_FRAME}
    assert run.stages["ratio"].left > 0
    assert set(run.methods) == set(FUSION_ASSOCIATIONS)
    assert run.methods["consistent"] == run.stages["+ consistency"]
    assert run.methods["nn"] == run.stages["+ mutual"]
    assert run.methods["hgtm"].wrong < run.methods["nn"].wrong
    for figures in (run.ate_m, run.pose_nees):
        assert set(figures) == {OWN, PEER}
        assert all(set(by_track) == set(TRACKS) for by_track in figures.values())
    assert run.ate_m[PEER]["unknown"] < 2.0  # in any other frame it would be tens of metres
    assert run.ate_m[OWN]["unknown"] != run.ate_m[OWN]["alone"]


def test_vehicles_that_share_too_little_stay_apart(flown: OwnOnlyTracks) -> None:
    run = run_together(flown, 1, 1.0)  # all that they share looks wrong
    assert run.first is None
    assert run.errors.shape == (0, 2)
    assert run.ate_m[OWN]["unknown"] == pytest.approx(run.ate_m[OWN]["alone"], rel=1e-12)
