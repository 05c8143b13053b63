# SPDX-License-Identifier: Apache-2.0
"""Pictures of feature tracks, made after a flight: the images are read again from the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from uav_vslam.datasets.bag_flight import BagFlight
    from uav_vslam.overlay.tracks import TrackOverlay
    from uav_vslam.pipeline import VehicleTrack


def write_sheet(flight: BagFlight, track: VehicleTrack, folder: Path, *, count: int) -> Path | None:
    """Write `<vehicle>_tracks.png`, a contact sheet of `count` frames through the flight; None without frames."""
    from uav_vslam.overlay.drawing import drawn
    from uav_vslam.overlay.tracks import evenly
    from uav_vslam.report.contact_sheet import contact_sheet
    from uav_vslam.report.style import save

    rows = evenly(count, len(track.outputs)).tolist()
    tiles = [(drawn(image, overlay), overlay.caption) for image, overlay in _with_images(flight, track, rows)]
    title = (
        f"{track.vehicle}: left images; filled: associated with the map, circles: other features, lines: past frames"
    )
    figure = contact_sheet(tiles, title)
    return None if figure is None else save(figure, folder / f"{track.vehicle}_tracks.png")


def write_film(flight: BagFlight, track: VehicleTrack, folder: Path, on_frame: Callable[..., None]) -> Path | None:
    """Write `<vehicle>_tracks.mp4` at the recorded frame rate; None without frames."""
    import numpy as np

    from uav_vslam.overlay.drawing import SUFFIX, captioned, drawn, write_video
    from uav_vslam.types import NS_PER_S

    stamps_ns = [output.report.pose.stamp_ns for output in track.outputs]
    if len(stamps_ns) < 2:
        return None

    def images() -> Iterator[NDArray[np.uint8]]:
        for image, overlay in _with_images(flight, track, range(len(stamps_ns))):
            on_frame()
            yield captioned(drawn(image, overlay), overlay)

    rate_hz = NS_PER_S / float(np.median(np.diff(stamps_ns)))
    return write_video(folder / f"{track.vehicle}_tracks{SUFFIX}", images(), rate_hz)


def _with_images(
    flight: BagFlight, track: VehicleTrack, rows: Sequence[int]
) -> Iterator[tuple[NDArray[Any], TrackOverlay]]:
    """Yield the left image and the overlay of each frame whose image can be read."""
    from uav_vslam.overlay.tracks import overlays

    images = flight.left_images({track.outputs[row].report.pose.stamp_ns for row in rows})
    stamp_ns, image = next(images, (-1, None))
    for overlay in overlays(track, flight.rig.left, rows):
        while image is not None and stamp_ns < overlay.stamp_ns:
            stamp_ns, image = next(images, (-1, None))
        if image is not None and stamp_ns == overlay.stamp_ns and image.shape[1::-1] == flight.image_size:
            yield image, overlay
