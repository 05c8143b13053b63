# SPDX-License-Identifier: Apache-2.0
"""The whole graph without ROS: each source through its vehicle's pipeline, then packets and fusion, at full speed."""
