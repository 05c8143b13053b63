# SPDX-License-Identifier: Apache-2.0
"""Simulated flights with ground truth: vehicle motion, IMU readings, landmarks and camera images."""
