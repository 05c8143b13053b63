# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 layer: nodes convert messages, call the algorithms and publish; no mathematics here."""
