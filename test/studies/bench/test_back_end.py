# SPDX-License-Identifier: Apache-2.0
"""Our back end and GTSAM get the same landmarks, and come to the same places."""

import numpy as np
import pytest

from uav_vslam.simulation.landmarks import LandmarkNoise, observe, scatter_landmarks
from uav_vslam.simulation.scenario import Scenario, simulate_vehicle
from uav_vslam.studies.bench.back_end import CHOLESKY, QR, back_end, thin_out

SIZE = (1280, 960)
COUNT = 20


@pytest.fixture(scope="module")
def frames():
    vehicle = simulate_vehicle(Scenario(frames=20), 0)
    field = scatter_landmarks([vehicle], per_frame=2 * COUNT)
    return list(observe(vehicle, field, noise=LandmarkNoise(wrong_share=0.1)))


def test_every_frame_shows_the_number_wanted_and_no_wrong_match(frames) -> None:
    for features, identities in thin_out(frames, COUNT, size=SIZE):
        assert len(features) == len(features.descriptors) == len(identities) == COUNT
        assert identities.min() >= 0


def test_a_landmark_is_shown_again_as_long_as_it_is_in_view(frames) -> None:
    thinned = thin_out(frames, COUNT, size=SIZE)
    for (_, before), (_, now), (_, offered) in zip(thinned, thinned[1:], frames[1:], strict=False):
        assert np.isin(np.intersect1d(before, offered), now).all()


def test_pixels_keep_their_identity(frames) -> None:
    for (features, identities), (all_features, all_identities) in zip(
        thin_out(frames, COUNT, size=SIZE), frames, strict=True
    ):
        rows = [int(np.flatnonzero(all_identities == identity)[0]) for identity in identities]
        np.testing.assert_array_equal(features.pixels, all_features.pixels[rows])


def test_too_few_landmarks_are_all_shown(frames) -> None:
    for (features, _), (_, offered) in zip(thin_out(frames, 1000, size=SIZE), frames, strict=True):
        assert len(features) <= np.sum(offered >= 0)
    assert len(thin_out(frames, 1000, size=SIZE)[0][0]) == np.sum(frames[0][1] >= 0)


@pytest.mark.parametrize("factorisation", [CHOLESKY, QR])
def test_both_track_the_flight_on_the_same_landmarks(factorisation: str) -> None:
    row = back_end(COUNT, 20, factorisation=factorisation)
    assert COUNT <= row["landmarks"] <= 1.2 * COUNT
    assert row["landmarks"] < row["gtsam_landmarks"] <= 1.4 * COUNT  # one frame longer in the state
    assert abs(row["end_rms_m"] - row["gtsam_end_rms_m"]) < 0.2 * (row["end_rms_m"] + row["gtsam_end_rms_m"])
    assert max(row["end_rms_m"], row["gtsam_end_rms_m"]) < 1.0  # 70 m at 0.5 degrees of yaw: 0.6 m
