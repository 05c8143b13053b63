# SPDX-License-Identifier: Apache-2.0
"""Cooperative stereo-inertial SLAM for several UAVs without GPS and without a server."""

__version__ = "0.1.0"
