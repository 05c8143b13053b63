# SPDX-License-Identifier: Apache-2.0
"""Trajectory files: reading TUM, KITTI and EuRoC, writing them and what maps show."""
