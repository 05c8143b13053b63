# SPDX-License-Identifier: Apache-2.0
"""What a reconstruction writes: poses, cameras, overlap, and figures of quality."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_vslam.evaluation.files.geodetic import to_geodetic
from uav_vslam.mapping.orthomosaic.seams import Seams
from uav_vslam.mapping.pictures.overlap import view_counts
from uav_vslam.mapping.pictures.procedure import cameras_of
from uav_vslam.mapping.pictures.reconstruction import Reconstruction
from uav_vslam.mapping.pictures.views import PictureViews

Figures = dict[str, Any]

POSES = ("picture", "x_{unit}", "y_{unit}", "z_{unit}", "qw", "qx", "qy", "qz", "points", "reprojection_px")
GEODETIC = ("latitude_deg", "longitude_deg", "altitude_m", "gps_distance_m")


def write_poses(found: Reconstruction, path: Path, *, unit: str) -> None:
    """Write one row a picture: T_map_cam (optical axes), its points, and, with GPS, the position and GPS's distance.

    Args:
        found: the pictures' poses.
        path: the CSV file.
        unit: of the map's lengths, for the titles of the columns.
    """
    scene, tracks, datum = found.adjusted.scene, found.adjusted.tracks, found.placement.datum
    error = np.linalg.norm(scene.residuals(tracks), axis=1)
    views = PictureViews(found.pictures, found.adjusted)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([title.format(unit=unit) for title in POSES + (GEODETIC if datum else ())])
        for number in found.adjusted.used.tolist():
            pose, own = views.pose(number), tracks.picture == number
            row = [found.pictures[number].name, *(f"{value:.4f}" for value in pose.t)]
            row += [f"{value:.8f}" for value in pose.quaternion_wxyz]
            row += [int(own.sum()), f"{float(np.sqrt((error[own] ** 2).mean())):.3f}"]
            if datum is not None and found.placement.gps_m is not None:
                longitude, latitude, altitude = to_geodetic(pose.t[None], datum)[0]
                distance = found.placement.gps_m[number]
                row += [f"{latitude:.8f}", f"{longitude:.8f}", f"{altitude:.3f}"]
                row += ["" if np.isnan(distance) else f"{distance:.3f}"]
            writer.writerow(row)


def camera_figures(found: Reconstruction) -> Figures:
    """Return the content of cameras.json: each camera's intrinsics, as `sensor_msgs/CameraInfo` has them."""
    names, lens_of = cameras_of(found.pictures)
    views, cameras = PictureViews(found.pictures, found.adjusted), {}
    for g, name in enumerate(names):
        own = np.flatnonzero(lens_of == g)
        camera, sigma = views.camera(int(own[0])), found.adjusted.lens_sigmas[g]
        cameras[name] = {
            "width": camera.width,
            "height": camera.height,
            "focal_px": camera.fx,
            "focal_sigma_px": float(sigma[0] * camera.fx),
            "principal_point_px": [camera.cx, camera.cy],
            "distortion_model": camera.model,
            "distortion": camera.distortion.tolist(),
            "pictures": len(np.intersect1d(own, found.adjusted.used)),
        }
    return cameras


def overlap_counts(found: Reconstruction) -> NDArray[np.uint16]:
    """Return (rows, columns) numbers of pictures that show each cell of the surface, south first."""
    views = PictureViews(found.pictures, found.adjusted)
    return view_counts(found.surface, ((views.camera(k), views.pose(k)) for k in found.adjusted.used.tolist()))


def overlap_figures(counts: NDArray[np.uint16], cell_m: float) -> Figures:
    """Return how often the ground is seen."""
    seen = counts[counts > 0]
    return {
        "area_m2": float(len(seen)) * cell_m**2,
        "mean_views": float(seen.mean()) if len(seen) else 0.0,
        "share_twice": float((seen >= 2).mean()) if len(seen) else 0.0,
    }


def seam_figures(found: Seams) -> Figures:
    """Return shifts [px of the mosaic] and steps of brightness at the seams; None where there are none."""
    figures = {name: value if np.isfinite(value) else None for name, value in found.figures().items()}
    return {"places": len(found.points), **figures}


def quality(found: Reconstruction) -> Figures:
    """Return figures of the adjustment."""
    scene, tracks, placement = found.adjusted.scene, found.adjusted.tracks, found.placement
    error = np.linalg.norm(scene.residuals(tracks), axis=1)
    left_out = np.setdiff1d(np.arange(len(found.pictures)), found.adjusted.used)
    figures: Figures = {
        "pictures": len(found.pictures),
        "used": len(found.adjusted.used),
        "left_out": [found.pictures[k].name for k in left_out],
        "pairs": found.pairs,
        "points": len(scene.points),
        "observations": len(tracks.point),
        "reprojection_px": {"rms": float(np.sqrt((error**2).mean())), "median": float(np.median(error))},
        "gsd_m": found.gsd_m,
        "height_m": found.height_m,
        "scale": placement.scale,
        "cameras": camera_figures(found),
    }
    if placement.gps_m is not None:
        figures["gps"] = {
            "median_m": float(np.nanmedian(placement.gps_m)),
            "most_m": float(np.nanmax(placement.gps_m)),
            "believed": placement.believed,
            "wrong": [found.pictures[k].name for k in placement.wrong],
        }
    return figures


def map_figures(found: Reconstruction, heights: NDArray[np.floating]) -> Figures:
    """Return the content of map.json but for the orthomosaic's own part; heights (rows, columns) are NaN if unknown."""
    raster, known = found.surface.raster, heights[np.isfinite(heights)]
    tree: Figures = {
        "cell_m": raster.cell_m,
        "gsd_m": found.gsd_m,
        "bounds_m": list(raster.bounds_m),
        "vehicles": {"pictures": {"views": len(found.adjusted.used), "share": 1.0}},
        "surface": {
            "cells": int(known.size),
            "height_m": [float(np.percentile(known, 1)), float(np.percentile(known, 99))],
        },
        "frame": "map",
    }
    datum = found.placement.datum
    if datum is not None:
        tree["datum"] = datum.figures()
    return tree


def pixel_size_m(gsd_m: float, area_m2: float, most_pixels: float) -> float:
    """Return a pixel of two digits, no smaller than the pictures' own and so that the mosaic keeps to a size."""
    least = max(gsd_m, float(np.sqrt(area_m2 / most_pixels)))
    step = 10.0 ** (np.floor(np.log10(least)) - 1.0)
    return float(np.ceil(least / step - 1e-9) * step)
