# SPDX-License-Identifier: Apache-2.0
"""Trajectories and landmarks for the plan view and the 3-D view."""

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.flight_tables import COVARIANCE
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.report.page.charts import Data, numbers, points_of_each, thinned
from uav_vslam.report.page.flight import FlightFiles, VehicleFiles
from uav_vslam.report.style import OWN_AXES, STYLES, axes_of

ROWS, COLUMNS = np.triu_indices(3)
MOST_LANDMARKS = 8000  # of all vehicles together
FLOOR_M2 = 1e-12  # variance at which an ellipsoid would be flat


def scene_data(flights: list[FlightFiles]) -> Data:
    """Return all flights' trajectories and landmarks [m] in their map frames."""
    vehicles = sum(len(flight.vehicles) for flight in flights)
    axes = {axes_of(flight.config) for flight in flights}
    return {
        "axes": axes.pop() if len(axes) == 1 else OWN_AXES,
        "tracks": {name: {"label": style.label, "width": style.width} for name, style in STYLES.items()},
        "flights": [
            {
                "label": flight.label,
                "vehicles": [_vehicle(flight, vehicle, vehicles) for vehicle in flight.vehicles.values()],
            }
            for flight in flights
        ],
    }


def _vehicle(flight: FlightFiles, vehicle: VehicleFiles, vehicles: int) -> Data:
    most = points_of_each(vehicles)
    return {
        "name": vehicle.name,
        "tracks": {name: _track(flight, track, most) for name, track in vehicle.tracks.items()},
        "landmarks": _landmarks(vehicle, points_of_each(vehicles, MOST_LANDMARKS)),
    }


def _track(flight: FlightFiles, track: Trajectory, most: int) -> Data:
    found = track.select(thinned(len(track), most))
    x, y, z = (numbers(values, decimals=3) for values in found.positions.T)
    data: Data = {"t": numbers(flight.seconds_of(found.stamps_ns), decimals=3), "x": x, "y": y, "z": z}
    data["q_wxyz"] = numbers(found.quaternions_wxyz.ravel(), decimals=4)
    if found.covariance is not None:
        variances = np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2)[:, :3], 0.0)
        data["sigma_m"] = numbers(np.sqrt(variances.sum(axis=1)), decimals=3)
        data["cov_plane"] = numbers(found.covariance[:, [0, 0, 1], [0, 1, 1]].ravel())
    return data


def _landmarks(vehicle: VehicleFiles, most: int) -> Data | None:
    """Return positions, and the lower triangle L of P = L L^T of each, which maps the unit sphere to its ellipsoid.

    Landmarks with a cell that is empty or not finite are left out.
    """
    table = vehicle.tables.get("landmarks")
    if not table or not table["id"]:
        return None
    positions = np.stack([table.numbers(name) for name in ("x_m", "y_m", "z_m")], axis=1)
    cells = np.stack([table.numbers(name) for name in COVARIANCE], axis=1)
    whole = np.isfinite(positions).all(axis=1) & np.isfinite(cells).all(axis=1)
    positions, cells = positions[whole], cells[whole]
    if len(positions) == 0:
        return None
    rows = thinned(len(positions), most)
    x, y, z = (numbers(values, decimals=2) for values in positions[rows].T)
    factors = numbers(_lower(cells[rows])[:, COLUMNS, ROWS].ravel())
    return {"count": len(positions), "x": x, "y": y, "z": z, "lower": factors}


def _lower(cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 3, 3) lower factors of covariances given by their upper triangles."""
    P = np.zeros((len(cells), 3, 3))
    P[:, ROWS, COLUMNS] = P[:, COLUMNS, ROWS] = cells
    values, vectors = np.linalg.eigh(P)
    P = (vectors * np.maximum(values, FLOOR_M2)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.asarray(np.linalg.cholesky(P))
