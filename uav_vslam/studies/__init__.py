# SPDX-License-Identifier: Apache-2.0
"""Comparisons over many seeds: each study defines methods, conditions and what it measures on one seed."""
