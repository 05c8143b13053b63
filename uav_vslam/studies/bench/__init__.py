# SPDX-License-Identifier: Apache-2.0
"""The speed of each stage beside a reference: what `uav-vslam bench` measures."""
