# SPDX-License-Identifier: Apache-2.0
"""Compares what came back with what was sent."""

import dataclasses
from typing import Any

import numpy as np

from uav_vslam.geometry.pose import Pose

ROTATION = 2e-15  # matrix to quaternion and back: 1.6e-15 at worst of 100 000; all else is bitwise equal


def assert_same(got: Any, sent: Any) -> None:
    """Compare two records field by field: rotations nearly, everything else exactly."""
    assert type(got) is type(sent)
    if isinstance(sent, Pose):
        np.testing.assert_allclose(got.R, sent.R, rtol=0, atol=ROTATION)
        np.testing.assert_array_equal(got.t, sent.t)
    elif dataclasses.is_dataclass(sent):
        for field in dataclasses.fields(sent):
            assert_same(getattr(got, field.name), getattr(sent, field.name))
    elif isinstance(sent, np.ndarray):
        assert got.dtype == sent.dtype
        np.testing.assert_array_equal(got, sent)
    else:
        assert got == sent
