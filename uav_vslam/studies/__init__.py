# SPDX-License-Identifier: Apache-2.0
"""Comparisons over many seeds: each study is a list of methods and conditions, and what one seed of them gives."""
