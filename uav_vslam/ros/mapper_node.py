# SPDX-License-Identifier: Apache-2.0
"""mapper: the surface and orthomosaic of what a vehicle flies over, while it flies.

in   left/image_raw, or left/image_raw/compressed    sensor_msgs/Image, CompressedImage
     left/camera_info, right/camera_info, /tf_static the rig
     slam/smoothed                                   geometry_msgs/PoseWithCovarianceStamped, a second or two late
     initial_state                                   uav_vslam_msgs/NavigationState, with start.method in_flight alone:
                                                     each one found is the origin of a map of its own
out  map/surface                                     sensor_msgs/PointCloud2, latched, map frame: cells' centres, rgb
     map/mesh                                        visualization_msgs/Marker, latched, map frame: triangles
srv  ~/save_map                                      std_srvs/Trigger: the map so far, into the folder map.folder
"""

import itertools
import time
from collections.abc import Callable
from pathlib import Path

from geometry_msgs.msg import Point, PoseWithCovarianceStamped
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from uav_vslam.config.files import expanded
from uav_vslam.datasets.messages import stamp_ns_of
from uav_vslam.datasets.unfinished import require_place
from uav_vslam.errors import InvalidMessage, UavVslamError
from uav_vslam.mapping.flight_views import LeftCamera
from uav_vslam.mapping.flown_map import FlownMap
from uav_vslam.mapping.summary import MapFrame
from uav_vslam.mapping.triangles import surface_triangles
from uav_vslam.mapping.waiting_images import WaitingImages
from uav_vslam.monitor import DROPPED
from uav_vslam.ros.calibration import RigListener
from uav_vslam.ros.convert import cloud_to_msg, header, image_from_msg, pose_from_msg
from uav_vslam.ros.inputs import image_topics
from uav_vslam.ros.qos import IMAGES, LATCHED, SENSOR
from uav_vslam.ros.runtime import run_node
from uav_vslam.ros.timers import create_wall_timer
from uav_vslam.ros.vehicle_node import VehicleNode
from uav_vslam_msgs.msg import NavigationState

MESH_STEP_M = 2.0  # sides of the triangles that are published
MOST_BUSY = 0.1  # share of the time that publishing the map may take
COLOUR = ColorRGBA(r=0.55, g=0.6, b=0.45, a=1.0)


class MapperNode(VehicleNode):
    """Feeds a `FlownMap` with images whose smoothed poses have arrived."""

    def __init__(self) -> None:
        super().__init__("mapper")
        self._map = self._new_map(beside=self.own.resume)
        self._published_pairs, self._idle_until_s = 0, 0.0
        self._images = WaitingImages()
        self._camera: LeftCamera | None = None  # once the calibration is known
        self._stamp_ns = 0
        self._start_ns: int | None = None  # of the start in flight that the map begins with
        self._surface = self.advertise(PointCloud2, "map/surface", LATCHED)
        self._mesh = self.advertise(Marker, "map/mesh", LATCHED)
        self._rig = RigListener(self)
        topic = self.config.input.topics.left
        for kind, name in image_topics(self, topic).items():
            self.listen(kind, name, self._on_image, IMAGES, instead_of=topic)
        self.listen(PoseWithCovarianceStamped, "slam/smoothed", self._on_pose, SENSOR)
        if self.config.start.method == "in_flight":
            self.listen(NavigationState, self.config.input.topics.initial_state, self._on_start, LATCHED)
        self.create_service(Trigger, "~/save_map", self._on_save)
        create_wall_timer(self, self.own.map.publish_s, self._publish)

    def _new_map(self, *, beside: bool) -> FlownMap:
        """Return an empty map, if need be in a folder beside earlier ones."""
        name = self.own.map.folder
        folder = expanded(name, "map.folder") if name else None
        if folder is not None and beside:
            others = (folder.with_name(f"{folder.name}_{number}") for number in itertools.count(2))
            folder = next(each for each in itertools.chain([folder], others) if not each.exists())
        if folder is not None:
            require_place(folder)
        return self._made_map(folder)

    def _made_map(self, folder: Path | None) -> FlownMap:
        frame = MapFrame(self.map_frame, north_up=not self.config.start.defines_map)
        return FlownMap(folder, frame, cell_m=self.own.map.cell_m, pixel_m=self.own.map.pixel_m)

    def reset(self) -> None:
        """Begin another map, in a folder beside the present one, which is saved."""
        self._replace_map(self._new_map(beside=True))  # before anything has ended: it may be refused
        self._rig.restart()
        self._images, self._camera = WaitingImages(), None

    def finish(self) -> int:
        """Save the whole map; return the exit code, 1 if that failed."""
        self._end_map()
        if alarm := self.alarms.get("map"):
            self.get_logger().error(alarm)
        return int(bool(alarm))

    def _on_start(self, message: NavigationState) -> None:
        """Begin another map with another start found in flight: its poses are in a frame of their own.

        An empty map, as after a reset, takes them.
        """
        before, self._start_ns = self._start_ns, stamp_ns_of(message)
        if before in (None, self._start_ns) or not self._map.mapper.views:
            return
        try:
            another = self._new_map(beside=True)
        except (UavVslamError, OSError) as error:
            self._alarm(error)
            another = self._made_map(None)
        self._replace_map(another)

    def _replace_map(self, another: FlownMap) -> None:
        self._end_map()
        self._map, self._published_pairs = another, 0

    def _end_map(self) -> None:
        if self._map.folder is not None and self._map.mapper.pairs:
            self._note_save(self._finish)
        self._map.close()

    def _on_image(self, message: Image | CompressedImage) -> None:
        self._images.add(stamp_ns_of(message) + self._rig.setup.time_offset_ns, image_from_msg(message))

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        if self._rig.rig is None:
            raise InvalidMessage("no_calibration", f"poses arrive, but {self._rig.missing}")
        self._camera = self._camera or LeftCamera(self.vehicle, self._rig.rig)
        self._stamp_ns = stamp_ns_of(message)
        pixels = self._images.take(self._stamp_ns)
        self.counts[f"{DROPPED}image_without_pose"] = self._images.dropped
        if pixels is None:
            self.counts[f"{DROPPED}pose_without_image"] += 1
            return
        view = self._camera.view(self._stamp_ns, pixels, pose_from_msg(message.pose.pose))
        try:
            self._map.add(view)
        except (UavVslamError, OSError) as error:  # tiles are written to make room for others, and read again
            self._alarm(error)
            self.drop("unsaved", f"a view is missing in the map: {error}")
            return
        self.counts["views"] += 1
        self.counts["pairs"] = self._map.mapper.pairs
        for reason, count in self._map.mapper.refused.items():
            self.counts[f"refused/{reason}"] = count

    def _publish(self) -> None:
        """Save the changed tiles and publish the map, if it has grown; the larger it is, the more rarely."""
        pairs = self._map.mapper.pairs
        if pairs == self._published_pairs:
            return
        if self._map.folder is not None:
            self._note_save(self._flush)
        if (begin_s := time.monotonic()) < self._idle_until_s:
            return
        self._published_pairs = pairs
        try:
            self._publish_map()
        except (UavVslamError, OSError) as error:  # as in `_on_pose`
            self._alarm(error)
        now_s = time.monotonic()
        self._idle_until_s = now_s + (now_s - begin_s) / MOST_BUSY

    def _publish_map(self) -> None:
        if self._surface.get_subscription_count():
            points, bgr = self._map.coloured()
            self._surface.publish(cloud_to_msg(points, bgr=bgr, stamp_ns=self._stamp_ns, frame_id=self.map_frame))
        if self._mesh.get_subscription_count():
            corners = surface_triangles(self._map.grid, MESH_STEP_M * self._map.stride).reshape(-1, 3).tolist()
            mesh = Marker(header=header(self._stamp_ns, self.map_frame), ns=self.vehicle, type=Marker.TRIANGLE_LIST)
            mesh.pose.orientation.w = mesh.scale.x = mesh.scale.y = mesh.scale.z = 1.0
            mesh.color, mesh.points = COLOUR, [Point(x=x, y=y, z=z) for x, y, z in corners]
            self._mesh.publish(mesh)

    def _note_save(self, save: Callable[[], str]) -> None:
        try:
            self.notes["map"] = save()
            self.alarms.pop("map", None)
        except (UavVslamError, OSError) as error:
            self._alarm(error)

    def _alarm(self, error: Exception) -> None:
        self.report_alarm("map", f"the map can't be saved: {error}", logged=True)

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = self._save(), True
        except (UavVslamError, OSError) as error:
            response.message, response.success = str(error), False
        return response

    def _flush(self) -> str:
        """Save what can change within a period: its cost does not grow with the flight."""
        self._map.grid.flush()
        return f"{self._map.folder}: tiles from {self._map.mapper.pairs} pairs"

    def _finish(self) -> str:
        """Save the whole map, without its last views if they can't be mapped."""
        try:
            self._map.finish()
        finally:
            saved = self._save()
        return saved

    def _save(self) -> str:
        tree = self._map.save()
        cells, cell_m = tree["surface"]["cells"], self._map.grid.cell_m
        return f"{self._map.folder}: {cells} cells of {cell_m:g} m from {self._map.mapper.pairs} pairs"


def main(args: list[str] | None = None) -> int:
    """Entry point."""
    return run_node(MapperNode, args, shared_memory=True)


if __name__ == "__main__":
    raise SystemExit(main())
