# SPDX-License-Identifier: Apache-2.0
"""Fusion with peers: inbox, common landmarks, split covariance intersection, and the fused track."""
