# SPDX-License-Identifier: Apache-2.0
"""The fusion study's rows: what they say follows from the runs behind them."""

import numpy as np
import pytest

from uav_vslam.config import FusionConfig, LinkConfig
from uav_vslam.evaluation.study import TABLE
from uav_vslam.simulation.scenario import Scenario
from uav_vslam.studies.engine.cooperation import Setting
from uav_vslam.studies.engine.fusion_parts import Part, run_parts
from uav_vslam.studies.engine.fusion_plot import FLEET, fleet_plot
from uav_vslam.studies.fusion.compute import PARTS

pytestmark = pytest.mark.slow

SETTINGS = (
    Setting("all"),
    Setting("narrow", {"mode": "narrowband"}),
    Setting("nothing arrives", link=LinkConfig(loss=1.0)),
    Setting("nothing sent", {"mode": "none"}),
    Setting("restarts", restarts=2),
    Setting("sum", {"scheme": "overlay"}),
    Setting("sum, feedback", {"scheme": "overlay", "feedback": True}),
    Setting("written back", write_back="overwrite"),
)


@pytest.fixture(scope="module")
def rows() -> dict[str, dict]:
    part = Part("short", Scenario(frames=60), SETTINGS)
    return {row["method"]: row for row in run_parts([part], [1], workers=1)}


def test_wrong_pairs_spoil_the_conventional_association_and_not_hypergraph_matching() -> None:
    settings = tuple(Setting(name, {"association": name}) for name in ("consistent", "nn", "hgtm"))
    part = Part("mistaken", Scenario(frames=60), settings, mistaken_share=0.3)
    found = {row["method"]: row for row in run_parts([part], [1], workers=1)}
    for name in ("consistent", "hgtm"):
        assert found[name]["ratio_to_s_slam"] < 1.0
    assert found["nn"]["ratio_to_s_slam"] > 2.0


def test_every_setting_has_a_row_over_every_vehicle(rows) -> None:
    assert list(rows) == [setting.name for setting in SETTINGS]
    assert {row["runs"] for row in rows.values()} == {2}


def test_peers_help_and_nothing_changes_where_nothing_arrives(rows) -> None:
    assert rows["all"]["ratio_to_s_slam"] < 1.0
    assert rows["nothing arrives"]["ratio_to_s_slam"] == pytest.approx(1.0)
    assert rows["nothing arrives"]["nees_position"] == pytest.approx(rows["all"]["s_slam_nees_position"], rel=0.01)
    assert rows["restarts"]["ratio_to_s_slam"] < 1.0


def test_no_packet_told_more_than_was_known_and_the_narrow_one_is_small(rows) -> None:
    for name in ("all", "narrow", "restarts"):
        assert rows[name]["lambda_excess"] <= 0.0
    assert rows["nothing sent"]["lambda_excess"] is None
    assert rows["narrow"]["packet_bytes_max"] < 1400
    assert rows["narrow"]["sent_bytes_per_s"] <= 900
    assert rows["all"]["sent_bytes_per_s"] <= 100_000


def test_a_plain_sum_of_own_maps_is_split_ci_and_counts_twice_what_feedback_returns(rows) -> None:
    for key in ("ate_rms_m", "nees_position"):
        assert rows["sum"][key] == rows["all"][key]
    assert rows["sum, feedback"]["nees_position"] > 1.3 * rows["sum"]["nees_position"]


@pytest.mark.parametrize(
    ("setting", "channel"),
    [
        (Setting(""), "own maps, up to 64 landmarks"),
        (Setting("", {"feedback": True, "relay": True}), "own maps, up to 64 landmarks, feedback, relay"),
        (Setting("", {"mode": "narrowband", "feedback": True}), "own maps, narrowband"),  # it returns none
        (Setting("", {"mode": "none"}), "nothing"),
        (Setting("", write_back="landmark_ci"), "fused maps, all landmarks (7.4.2, wideband)"),
    ],
)
def test_a_row_names_the_channel_that_it_was_measured_with(setting: Setting, channel: str) -> None:
    assert setting.channel(FusionConfig()) == channel


def test_runs_that_break_down_are_counted_and_leave_no_error(rows) -> None:
    assert rows["written back"]["failures"] == 2
    assert rows["written back"]["ate_rms_m"] is None


def test_all_parts_can_be_made_and_their_settings_differ_by_name() -> None:
    tables = [part for make in PARTS.values() for part in make(20)]
    assert len({part.table for part in tables}) == len(tables)
    for part in tables:
        assert len({setting.name for setting in part.settings}) == len(part.settings)


def test_fleets_that_flew_too_short_for_an_epoch_are_drawn() -> None:
    figures = {"ratio_to_s_slam": 1.0, "sent_bytes_per_s": 9e4, "ms_per_epoch": None}
    lines = fleet_plot([{TABLE: f"{count}{FLEET}"} | figures for count in (2, 3)]).axes[2].lines
    assert np.isnan(lines[0].get_ydata()).all()
