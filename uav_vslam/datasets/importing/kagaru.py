# SPDX-License-Identifier: Apache-2.0
"""A folder of pictures, frame times and a log, laid out as a configuration says, as a flight recording.

Made for the Kagaru flights, of which the layout is not known here: file patterns, columns, units, axes, clocks, Bayer
pattern and calibration are settings (`kagaru_settings`). Body is the log's sensor with its axes turned to FLU.
"""

from pathlib import Path

from uav_vslam.config import find_config, load_vehicle, replaced
from uav_vslam.datasets.flight_writer import FlightRecording
from uav_vslam.datasets.importing.axes import rotation_to_flu
from uav_vslam.datasets.importing.kagaru_log import contradictions, read_imu, read_motion
from uav_vslam.datasets.importing.kagaru_pictures import encoding_of, read_pairs
from uav_vslam.datasets.importing.kagaru_settings import read_settings
from uav_vslam.datasets.importing.motion import InitialSigma, imu_samples
from uav_vslam.datasets.importing.pictures import covered_pairs, frames, pairs_with_readings, shifted, uncovered_text
from uav_vslam.datasets.importing.problems import Problems
from uav_vslam.datasets.importing.rigs import rig_of_files, rig_of_values, turned
from uav_vslam.datasets.importing.source import IN_FLIGHT, Source
from uav_vslam.errors import BagError


def read_kagaru(
    folder: Path,
    layout_file: Path,
    *,
    vehicle: str = "uav1",
    sigma: InitialSigma | None = None,
    problems: Problems | None = None,
) -> Source:
    """Read a data set; it starts at the first image pair with readings and, if there is any, ground truth.

    Args:
        folder: of the data set.
        layout_file: its layout, see `config/import/kagaru.yaml`.
        vehicle: its ROS namespace.
        sigma: stated uncertainty of the start state; None for the layout's.
        problems: collects what is left out.

    Raises:
        ConfigError: the layout is wrong or incomplete.
        BagError: a file is missing or malformed, or no images pair up.
        CalibrationError: the calibration is missing or does not fit the images.
    """
    problems = problems or Problems()
    layout, run = read_settings(layout_file)
    replaced(load_vehicle(find_config(layout.base) if layout.base else None), run, where=f"{layout_file}: run")
    files = [layout_file.parent / path for path in layout.calibration.files]
    rig, offset_ns = rig_of_files(files) if files else (rig_of_values(layout.calibration, layout_file), 0)
    rig = turned(rig, rotation_to_flu(layout.log.body_axes))
    imu = read_imu(folder, layout.log, problems)
    pairs = shifted(read_pairs(folder, layout.cameras, problems), offset_ns)
    flown, without = pairs_with_readings(pairs, imu)
    notes = list(without)
    truth, origin = read_motion(folder, layout.navigation, layout.datum, problems)
    if origin:
        datum = f"{origin.latitude_deg:.9f} {origin.longitude_deg:.9f} {origin.altitude_m:.3f}"
        notes.append(f"datum: {datum} is the origin of the world")
    flown, outside = covered_pairs(flown, truth, lacking="the log has no pose")
    notes.extend(outside)
    if not flown:
        raise BagError(f"{folder}: {uncovered_text(pairs, imu, truth)}; check time_units and time_offset_s")
    flight = FlightRecording(
        vehicle=vehicle,
        rig=rig,
        imu=imu_samples(imu),
        truth=truth.samples(imu) if truth else (),
        frames=frames(flown, rig, problems, encoding=encoding_of(flown, layout.cameras.bayer, rig)),
        initial=truth.start(flown[0].stamp_ns, sigma or InitialSigma(*layout.start_sigma)) if truth else None,
    )
    warnings = tuple(contradictions(imu, truth)) if truth else ()
    settings = {**({} if truth else IN_FLIGHT), **run}
    return Source(flight, len(flown), base=layout.base, settings=settings, notes=tuple(notes), warnings=warnings)
