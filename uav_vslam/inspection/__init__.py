# SPDX-License-Identifier: Apache-2.0
"""Judges a recording before it is run: arrays and records in, findings out. `recording.inspect` calls all checks."""
