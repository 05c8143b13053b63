# SPDX-License-Identifier: Apache-2.0
"""Draws the covariance of a vehicle's last position, alone and with peers, as ellipsoids about the truth."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from uav_vslam.evaluation.pairing import pair_with_truth
from uav_vslam.evaluation.result import FlightResult
from uav_vslam.report.style import STYLES, tracks_of

Array = NDArray[np.float64]

SIGMAS = 2.0
RINGS = 24
TICKS = 5  # of an axis at most: the labels of more overlap where it is foreshortened


def ellipsoid_plot(result: FlightResult) -> Figure | None:
    """Return the 2-sigma ellipsoids of the last positions, a view per vehicle; None where no truth is known."""
    vehicles = [vehicle for vehicle in result.vehicles.values() if vehicle.truth is not None]
    if not vehicles:
        return None
    figure = Figure(figsize=(6.0 * len(vehicles), 6.0))
    for place, vehicle in enumerate(vehicles, start=1):
        axes: Any = figure.add_subplot(1, len(vehicles), place, projection="3d")
        reach = 0.0
        for name, track in tracks_of(vehicle).items():
            if name in ("s_slam", "c_slam") and track.covariance is not None and vehicle.truth is not None:
                estimate, truth = pair_with_truth(track, vehicle.truth)
                error = estimate.positions[-1] - truth.positions[-1]
                surface = error + ellipsoid(track.covariance[-1][:3, :3])
                axes.plot_wireframe(*surface.transpose(2, 0, 1), color=STYLES[name].colour, linewidth=0.5, alpha=0.6)
                reach = max(reach, float(np.abs(surface).max()))
        axes.computed_zorder = False  # the truth is inside: draw it over the ellipsoids
        axes.scatter(0, 0, 0, color=STYLES["truth"].colour, s=60, zorder=10)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
        axes.set(xlabel="East [m]", ylabel="North [m]", zlabel="Up [m]", title=vehicle.name)
        axes.set_box_aspect((1, 1, 1), zoom=1.0)
        axes.locator_params(nbins=TICKS)
    handles = [
        Line2D([], [], color=STYLES[n].colour, label=f"{STYLES[n].label}, 2 sigma") for n in ("s_slam", "c_slam")
    ]
    handles.append(Line2D([], [], color=STYLES["truth"].colour, marker="o", linestyle="", label="Truth"))
    figure.suptitle(f"{result.name}: last position less truth")
    figure.legend(handles=handles, loc="lower center", ncols=3, frameon=False)
    return figure


def ellipsoid(covariance: Array) -> Array:
    """Return (R, R, 3) points on the surface where the error is `SIGMAS` sigmas [m]."""
    u, v = np.linspace(0.0, 2.0 * np.pi, RINGS), np.linspace(0.0, np.pi, RINGS)
    sphere = np.stack(
        [np.outer(np.cos(u), np.sin(v)), np.outer(np.sin(u), np.sin(v)), np.outer(np.ones(RINGS), np.cos(v))]
    )
    return np.asarray(SIGMAS * np.einsum("ij,jkl->kli", np.linalg.cholesky(covariance), sphere))
