# SPDX-License-Identifier: Apache-2.0
"""The `uav-vslam` command: one verb a file."""
