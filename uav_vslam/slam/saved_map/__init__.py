# SPDX-License-Identifier: Apache-2.0
"""A map that outlives its flight: collected from a filter's beliefs, saved, loaded, and a start for later flights.

A filter's joint covariance over all landmarks ever mapped would be huge, and few of its entries are needed: a vehicle
sees one place at a time. So the map is a list of sections, each with the landmarks of about one view of the ground.
Within a section the covariance bounds the exact one, in a form like a narrowband packet's: one rigid error common to
its landmarks, the drift up to there, and an independent one of each. How the errors of different sections are
correlated is not stored: what uses two of them together has to treat them as correlated to an unknown degree.
"""

from uav_vslam.slam.saved_map.file import load_map, save_map
from uav_vslam.slam.saved_map.record import MapOrigin, Mapped, MappedPlace, MapSection, SavedMap

__all__ = ["MapOrigin", "MapSection", "Mapped", "MappedPlace", "SavedMap", "load_map", "save_map"]
