# SPDX-License-Identifier: Apache-2.0
"""Simulated flights with exact truth: vehicle motion, inertial readings, landmarks and camera images."""
