# SPDX-License-Identifier: Apache-2.0
"""Opens recordings before a run; one that can't be run is refused with the command that names all its faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uav_vslam.config import VehicleConfig
    from uav_vslam.datasets.bag import BagFlight


def open_flights(bags: Sequence[Path], configs: Mapping[str, VehicleConfig]) -> dict[str, BagFlight]:
    """Open each vehicle's recording and check its first images.

    Raises:
        BagError: a path is missing or not a bag, or a topic is missing.
        CalibrationError: a sensor's place is unknown, or calibration and images contradict each other.
    """
    from uav_vslam.datasets.bag import open_flight
    from uav_vslam.datasets.rosbag import topics_of
    from uav_vslam.errors import BagError, CalibrationError

    topics_of(bags)  # of what is no bag, nothing else can be said
    try:
        flights = {name: open_flight(bags, name, config.input) for name, config in configs.items()}
        for flight in flights.values():
            flight.check_images()
    except (BagError, CalibrationError) as error:
        raise type(error)(f"{error}. All faults: uav-vslam check {' '.join(map(str, bags))}") from None
    return flights
