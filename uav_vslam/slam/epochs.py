# SPDX-License-Identifier: Apache-2.0
"""Epochs: the stamps at which packets are made and fused."""

from uav_vslam.types import NS_PER_S


def crosses_epoch(previous_ns: int | None, stamp_ns: int, epoch_s: float) -> bool:
    """Return whether a multiple of the epoch is in (previous, stamp]; a first frame, without a previous one, has none.

    It depends on stamps alone, so that all nodes of a vehicle agree without communicating.
    """
    period = round(epoch_s * NS_PER_S)
    return previous_ns is not None and stamp_ns // period != previous_ns // period
