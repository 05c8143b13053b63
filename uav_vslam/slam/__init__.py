# SPDX-License-Identifier: Apache-2.0
"""The own-only SLAM of one vehicle: map management, the back end, and the packet made from its estimate."""
