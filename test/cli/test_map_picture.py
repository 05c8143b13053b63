# SPDX-License-Identifier: Apache-2.0
"""The picture of a fleet whose cameras are of different kinds is in colour."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import pytest
from flown_scene import Scene

from uav_vslam.cli.map_picture import _chosen, _key_frames
from uav_vslam.errors import UavVslamError
from uav_vslam.geometry.pose import Pose
from uav_vslam.mapping.orthomosaic import blended_mosaic
from uav_vslam.mapping.surface.grid import HeightGrid
from uav_vslam.mapping.view import View

SCENE = Scene()
M_PER_PX = 0.2


def view(vehicle: str, k: int, *, colour: bool) -> View:
    seen = SCENE.view((9.0 * k, 3.0 * (vehicle == "uav2"), 30.0))
    seen = replace(seen, vehicle=vehicle, stamp_ns=k)
    return seen.in_colour() if colour else seen


@dataclass(frozen=True)
class Flown:
    """Stands for a `MappedFlight`: three views of one vehicle."""

    flight: Any
    colour: bool
    poses: dict[int, Pose] = field(default_factory=lambda: dict.fromkeys(range(3), Pose.identity()))

    def __len__(self) -> int:
        return len(self.poses)

    def views(self) -> Iterator[View]:
        return (view(self.flight.vehicle, k, colour=self.colour) for k in self.poses)


@pytest.mark.parametrize(
    ("colours", "channels"), [((False, False), 1), ((False, True), 3), ((True, False), 3), ((True, True), 3)]
)
def test_grey_views_become_coloured_where_others_are(colours: tuple[bool, bool], channels: int) -> None:
    flights: Any = [Flown(SimpleNamespace(vehicle=f"uav{k + 1}"), colour) for k, colour in enumerate(colours)]
    stamps, colour = _key_frames(flights, HeightGrid(0.5))
    mosaic = blended_mosaic(lambda: _chosen(flights, stamps, colour=colour), SCENE, M_PER_PX)
    assert {added.vehicle for added in mosaic.views} == {"uav1", "uav2"}
    assert mosaic.tiles.channels == channels


def test_a_mosaic_of_both_kinds_of_views_is_refused() -> None:
    views = [view("uav1", 0, colour=False), view("uav2", 0, colour=True)]
    with pytest.raises(UavVslamError, match="views in grey and in colour"):
        blended_mosaic(lambda: iter(views), SCENE, M_PER_PX)
