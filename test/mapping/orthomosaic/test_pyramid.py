# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from uav_vslam.mapping.orthomosaic.pyramid import ALIGN, LEVELS, fill, put_together, take_apart

RNG = np.random.default_rng(0)
IMAGE = RNG.uniform(0.0, 255.0, (6 * ALIGN, 8 * ALIGN, 3)).astype(np.float32)
SEEN = np.ones(IMAGE.shape[:2], np.float32)


@pytest.mark.parametrize("channels", [1, 3])
def test_bands_add_up_to_the_image(channels: int) -> None:
    image = IMAGE[..., :channels]
    bands = take_apart(image, SEEN)
    np.testing.assert_allclose(put_together(bands.coefficients), image, atol=1e-3)
    assert [band.shape[2] for band in bands.coefficients] == [channels] * (LEVELS + 1)


def test_windows_at_different_places_share_their_bands() -> None:
    """Otherwise views side by side would not add up to one picture."""
    whole, cut = take_apart(IMAGE, SEEN), take_apart(IMAGE[ALIGN:, 2 * ALIGN :], SEEN[ALIGN:, 2 * ALIGN :])
    for level in range(3):
        inside = 2 * ALIGN >> level
        a = whole.coefficients[level][ALIGN >> level :, 2 * ALIGN >> level :]
        np.testing.assert_allclose(
            a[inside:-inside, inside:-inside], cut.coefficients[level][inside:-inside, inside:-inside], atol=1e-3
        )


def test_what_is_known_stays_and_the_rest_continues_it() -> None:
    image = np.full((96, 96, 1), 70.0, np.float32)
    known = np.zeros((96, 96), bool)
    known[30:50, 20:70] = True
    image[~known] = -1e4
    filled = fill(image, known)
    np.testing.assert_allclose(filled, 70.0, atol=0.01)
    ramp = np.where(known, np.arange(96.0), np.nan).astype(np.float32)[..., None]
    filled = fill(np.nan_to_num(ramp), known)
    np.testing.assert_array_equal(filled[known], ramp[known])
    assert filled.min() >= 19.0
    assert filled.max() <= 70.0


def test_a_band_weighs_less_where_part_of_it_is_not_seen() -> None:
    score = SEEN.copy()
    score[:, : 4 * ALIGN] = 0.0
    for level, weights in enumerate(take_apart(IMAGE, score).weights):
        edge = 4 * ALIGN >> level
        assert weights[4, -1] == pytest.approx(1.0, abs=1e-5)
        assert (weights > 0).all()
        assert weights[4, 0] < 1e-3
        assert level == 0 or weights[4, edge] < 0.7
