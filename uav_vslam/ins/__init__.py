# SPDX-License-Identifier: Apache-2.0
"""Inertial navigation: preintegration between image stamps, and its error model."""
