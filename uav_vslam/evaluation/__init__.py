# SPDX-License-Identifier: Apache-2.0
"""Evaluation of flights: errors against ground truth, consistency, and the results folder."""
