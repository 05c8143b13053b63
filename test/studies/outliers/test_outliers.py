# SPDX-License-Identifier: Apache-2.0
import pytest

from uav_vslam.studies.outliers.compute import CLEAN, outlier_rows, outlier_trials


def test_each_kind_of_wrong_match_grows_from_none_to_a_fifth():
    trials = outlier_trials({"defaults": {}})
    shares = {trial.condition: (trial.noise.wrong_share, trial.noise.lookalike_share) for trial in trials}
    assert shares == {
        CLEAN: (0.0, 0.0),
        "swapped 0.05": (0.05, 0.0),
        "swapped 0.1": (0.1, 0.0),
        "swapped 0.2": (0.2, 0.0),
        "lookalike 0.05": (0.0, 0.05),
        "lookalike 0.1": (0.0, 0.1),
        "lookalike 0.2": (0.0, 0.2),
    }


def test_errors_stand_beside_the_same_settings_clean_ones(make_run):
    runs = [
        make_run(name, end=(end, 0.0, 0.0), condition=condition)
        for condition, ends in ((CLEAN, (1.0, 2.0)), ("lookalike 0.1", (1.5, 6.0)))
        for name, end in zip(("robust", "plain"), ends, strict=True)
    ]
    rows = outlier_rows(runs)
    assert [(row["method"], row["kind"], row["wrong_match_share"]) for row in rows] == [
        ("robust", "clean", 0.0),
        ("robust", "lookalike", 0.1),
        ("plain", "clean", 0.0),
        ("plain", "lookalike", 0.1),
    ]
    assert [row["end_ratio_to_clean"] for row in rows] == pytest.approx([1.0, 1.5, 1.0, 3.0])
