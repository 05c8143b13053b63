# SPDX-License-Identifier: Apache-2.0
"""The study of unknown frames: what counts as good, and what is pooled over what."""

import numpy as np
import pytest

from uav_vslam.evaluation.study import TABLE
from uav_vslam.studies.engine.association_stages import Score
from uav_vslam.studies.frames import rows as study
from uav_vslam.studies.frames.compute import FirstAlignment, FrameRun


def run(*, seed=1, share=0.3, after_s=2.0, errors=((0.5, 0.1), (0.1, 0.1)), alone=(1.0, 2.0), unknown=(0.9, 1.0)):
    first = (
        FirstAlignment(after_s, Score(10, 7, 7, 7), Score(7, 7, 7, 7), (0.2, 0.1), (0.7, 0.4), 0.8) if errors else None
    )
    ate = {
        name: {"alone": a, "unknown": u, "known": 0.5}
        for name, a, u in zip(("uav1", "uav2"), alone, unknown, strict=True)
    }
    figures = np.array(errors).reshape(-1, 2)
    return FrameRun(seed, share, first, figures, ate, ate, {"ratio": Score(10, 9, 9, 10)}, {"hgtm": Score(8, 8, 8, 10)})


def test_good_is_found_in_time_and_near() -> None:
    assert study.is_good(run())
    assert not study.is_good(run(after_s=30.5))
    assert not study.is_good(run(errors=[(1.6, 0.1)]))
    assert not study.is_good(run(errors=[(0.5, 1.1)]))
    assert not study.is_good(run(errors=[]))


def test_what_is_pooled_over_what() -> None:
    row = study._pooled([run(), run(errors=[(1.5, 0.3)]), run(errors=[])])
    assert (row["runs"], row["found"], row["good"]) == (3, 2, 2)
    assert row["wrong_share"] == 0.3
    assert row["error_median_m"] == 1.0
    assert row["error_worst_deg"] == 0.3
    assert (row["weighted_worst_m"], row["true_worst_m"], row["true_worst_deg"]) == (0.2, 0.7, 0.4)
    assert row["later_rms_m"] == pytest.approx(np.sqrt((0.25 + 0.01 + 2.25) / 3))
    assert study._pooled([run(errors=[])])["error_worst_m"] is None


def test_the_better_vehicle_is_the_one_that_is_better_alone() -> None:
    alone, unknown, _ = study._trajectories([run(), run(alone=(3.0, 1.0), unknown=(1.0, 1.1))])
    assert alone["better_ate_rms_m"] == alone["ratio_to_s_slam"] == 1.0
    assert unknown["better_ratio_to_s_slam"] == pytest.approx(np.sqrt((0.9**2 + 1.1**2) / 2))
    assert alone["ate_rms_m"] == pytest.approx(np.sqrt((1 + 4 + 9 + 1) / 4))


def test_the_study_has_its_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    def fly(scenario):
        return [
            run(seed=scenario.seed, share=share, errors=[] if share == 0.5 else [(0.5, 0.1)]) for share in study.SHARES
        ]

    monkeypatch.setattr(study, "run_seed", fly)
    done: list[None] = []
    rows = study.frame_rows([1, 2], frames=9, workers=1, on_seed=lambda: done.append(None))
    tables = [row[TABLE] for row in rows]
    assert list(dict.fromkeys(tables)) == [
        "frame of the peer's map",
        "trajectories",
        "stages of association",
        "methods of association, fusion.association",
        "seed by seed",
    ]
    assert tables.count("frame of the peer's map") == len(study.SHARES)
    singles = [row for row in rows if row[TABLE] == "seed by seed"]
    assert [(row["condition"], row["seed"], row["good"]) for row in singles] == [
        ("30% mistaken", 1, True),
        ("30% mistaken", 2, True),
        ("50% mistaken", 1, False),
        ("50% mistaken", 2, False),
    ]
    assert len(done) == 2
