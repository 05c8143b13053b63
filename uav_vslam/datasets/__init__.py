# SPDX-License-Identifier: Apache-2.0
"""Recordings: reading and writing ROS 2 bags without ROS, and importing other formats into them."""
