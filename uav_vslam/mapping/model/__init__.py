# SPDX-License-Identifier: Apache-2.0
"""A textured model of the surface: triangles from the heights, colours from the orthomosaic."""

from uav_vslam.mapping.model.files import write_model

__all__ = ["write_model"]
