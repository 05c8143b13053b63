# SPDX-License-Identifier: Apache-2.0
"""The results folder of a made-up flight of two vehicles, with everything that a run may leave."""

import dataclasses
from pathlib import Path

import numpy as np

from uav_vslam.evaluation.output import write_results
from uav_vslam.evaluation.result import FlightResult, LinkCounters, VehicleResult
from uav_vslam.evaluation.trajectory import Trajectory
from uav_vslam.types import FrameQuality, LinkEpoch, MappedLandmarks

START_NS = 10**18 + 7
PERIOD_NS = 100_000_000
FRAMES = 100
DARK = (20, 21, 60)  # frames without an update
LANDMARKS = 50
COVARIANCE = np.array([[1.0, 0.4, 0.1], [0.4, 4.0, -0.3], [0.1, -0.3, 0.25]])  # of each landmark [m^2]
NAMES = ("uav1", "uav2")


def track(offset_m: float, *, north_m: float, sigma_m: float = 0.5, known: bool = True) -> Trajectory:
    """Return poses eastward at 20 m/s, `offset_m` too far north at the end."""
    t = 0.1 * np.arange(FRAMES)
    positions = np.stack([20 * t, north_m + offset_m * t / t[-1], 70.0 + 0.1 * t], axis=1)
    covariance = np.tile(sigma_m**2 * np.eye(6), (FRAMES, 1, 1)) if known else None
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1))
    return Trajectory(START_NS + PERIOD_NS * np.arange(FRAMES, dtype=np.int64), positions, quaternions, covariance)


def frame(k: int) -> FrameQuality:
    """Return the record of a frame."""
    dark = k in DARK
    return FrameQuality(
        START_NS + PERIOD_NS * k, 90, 80, 25, 0, 60, dark, False, False, 0, 0.0 if dark else 90.0 + k,
        0 if dark else 100, 0.99, ("<b>a problem</b>",) if k == 40 else (), -2e-4, 1e-4, 0.02, 0.0 if dark else 0.01,
    )  # fmt: skip


def landmarks(north_m: float) -> MappedLandmarks:
    """Return landmarks below the path."""
    ids = np.arange(LANDMARKS, dtype=np.uint32)
    positions = np.column_stack([4.0 * ids, north_m + 20.0 * np.sin(ids), np.zeros(LANDMARKS)])
    return MappedLandmarks(ids, positions, np.tile(COVARIANCE, (LANDMARKS, 1, 1)))


def vehicle(name: str, north_m: float) -> VehicleResult:
    """Return a vehicle with all records."""
    epochs = tuple(LinkEpoch(START_NS + 10 * PERIOD_NS * k, k, 1000 * k, k, 900 * k, k) for k in range(10))
    stamps = [START_NS + PERIOD_NS * k for k in range(FRAMES)]
    return VehicleResult(
        name=name,
        truth=track(0.0, north_m=north_m, known=False),
        ins=track(30.0, north_m=north_m),
        s_slam=track(2.0, north_m=north_m),
        c_slam=track(1.0, north_m=north_m),
        smoothed=track(0.5, north_m=north_m),
        frames_in=FRAMES + 1,
        frames_processed=FRAMES,
        frames=tuple(map(frame, range(FRAMES))),
        alarms={},
        landmarks=landmarks(north_m),
        link=LinkCounters(900.0, 9, 9, 8, {"stale": 1}),
        epochs=epochs,
        stage_s={"frontend": dict.fromkeys(stamps, 0.01), "backend": dict.fromkeys(stamps, 0.03)},
    )


CONFIG = {
    f"/{name}/**": {
        "ros__parameters": {"backend": {"window": 10, "sigma_px": sigma_px}, "fusion": {"mode": "wideband"}}
    }
    for name, sigma_px in zip(NAMES, (1.0, 0.8), strict=True)
}
VEHICLES = {name: vehicle(name, north_m) for name, north_m in zip(NAMES, (0.0, 40.0), strict=True)}
FLIGHT = FlightResult("made up </script>", 5, "wideband", 9.9, 3.3, VEHICLES, CONFIG)


def write_full(root: Path) -> Path:
    """Write the flight below a folder and return the folder of the results."""
    return write_results(FLIGHT, root)


def write_long(root: Path) -> Path:
    """Write the two vehicles with tracks of 4000 poses of random errors and 5000 landmarks each."""
    rng = np.random.default_rng(7)

    def noisy(name: str) -> VehicleResult:
        stamps = START_NS + 10_000_000 * np.arange(4_000, dtype=np.int64)
        walks = [np.cumsum(rng.normal(size=(len(stamps), 3)), axis=0) for _ in range(4)]
        covariance = rng.uniform(0.1, 9.0, (len(stamps), 1, 1)) * np.eye(6)
        turned = rng.normal(size=(len(stamps), 4))
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        truth, ins, own, fused = (Trajectory(stamps, walk, turned, covariance) for walk in walks)
        frames = tuple(dataclasses.replace(frame(k), nis=float(rng.uniform(50, 150))) for k in range(2000))
        return dataclasses.replace(
            VEHICLES[name], truth=truth, ins=ins, s_slam=own, c_slam=fused, smoothed=own, frames=frames
        )

    folder = write_results(dataclasses.replace(FLIGHT, vehicles={name: noisy(name) for name in NAMES}), root)
    for name in NAMES:
        numbers = np.round(rng.uniform(1.0, 200.0, (5_000, 3)), 4)
        rows = [f"{k},{x},{y},{z},3.14159,0.1,0.2,2.71828,0.3,1.61803" for k, (x, y, z) in enumerate(numbers.tolist())]
        head = (folder / f"{name}_landmarks.csv").read_text().splitlines()[0]
        (folder / f"{name}_landmarks.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder


def write_bare(root: Path) -> Path:
    """Write one vehicle that knows neither truth, nor peers, nor records."""
    alone = VehicleResult("uav1", None, track(3.0, north_m=0.0), track(1.0, north_m=0.0), None, None, FRAMES)
    return write_results(dataclasses.replace(FLIGHT, name="bare", vehicles={"uav1": alone}, config={}), root)
