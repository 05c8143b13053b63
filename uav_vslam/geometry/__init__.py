# SPDX-License-Identifier: Apache-2.0
"""Rotations, poses, cameras and stereo rigs; numpy only."""
