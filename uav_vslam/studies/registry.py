# SPDX-License-Identifier: Apache-2.0
"""All studies by name, in the order of `uav-vslam study --help`."""

from uav_vslam.studies import (
    association,
    euroc,
    faults,
    features,
    filters,
    flights,
    frames,
    front_end,
    fusion,
    live,
    long,
    models,
    outliers,
    radio,
    recordings,
    revisit,
    rig,
    split,
    start,
    thesis,
)
from uav_vslam.studies.engine.study import Study

STUDIES: dict[str, Study] = {
    "models": models.STUDY,
    "fusion": fusion.STUDY,
    "thesis": thesis.STUDY,
    "frames": frames.STUDY,
    "flights": flights.STUDY,
    "radio": radio.STUDY,
    "live": live.STUDY,
    "filters": filters.STUDY,
    "long": long.STUDY,
    "revisit": revisit.STUDY,
    "rig": rig.STUDY,
    "outliers": outliers.STUDY,
    "features": features.STUDY,
    "front_end": front_end.STUDY,
    "faults": faults.STUDY,
    "euroc": euroc.STUDY,
    "split": split.STUDY,
    "association": association.STUDY,
    "start": start.STUDY,
    "recordings": recordings.STUDY,
}
