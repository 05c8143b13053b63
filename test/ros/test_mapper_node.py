# SPDX-License-Identifier: Apache-2.0
"""The mapper makes of images and late poses the surface that the core makes of the same views."""

import json
import math
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="needs ROS")
from lone_node import deliver, lone_node  # noqa: E402
from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402
from rendered_views import CAMERA, ground, view  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, PointCloud2  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from uav_vslam.errors import BagError  # noqa: E402
from uav_vslam.geometry.pose import Pose  # noqa: E402
from uav_vslam.mapping.flown_map import UNSEEN_GREY  # noqa: E402
from uav_vslam.mapping.surface.grid import HeightGrid  # noqa: E402
from uav_vslam.mapping.surface.mapper import SurfaceMapper  # noqa: E402
from uav_vslam.ros.convert import flat, header, navigation_to_msg, pose_with_covariance_to_msg, transform_to_msg  # noqa: E402
from uav_vslam.ros.lifecycle import INACTIVE  # noqa: E402
from uav_vslam.ros.mapper_node import MapperNode  # noqa: E402
from uav_vslam.ros.qos import LATCHED  # noqa: E402
from uav_vslam.ros.runtime import finish  # noqa: E402
from uav_vslam.types import NavEstimate, NavState, PoseEstimate  # noqa: E402
from waiting import wait_for  # noqa: E402

pytestmark = pytest.mark.ros

VIEWS = 10
LONGER = 14  # until the first key frame has settled
LATE = 4  # frames by which a pose comes after its image
T_BODY_LEFT = Pose(np.eye(3), np.array([0.1, 0.0, -0.05]))
Make = Callable[..., MapperNode]


@pytest.fixture
def make(domain_id: int) -> Iterator[Make]:
    """Return a factory of a node with parameters."""
    with lone_node(MapperNode, domain_id) as made:
        yield made


def calibrate(node: MapperNode) -> None:
    right = Pose(np.eye(3), np.array([0.1, 0.8, -0.05]))
    edges = [
        transform_to_msg(T, stamp_ns=0, parent=node.base_frame, child=f"{side}_optical")
        for side, T in (("left", T_BODY_LEFT), ("right", right))
    ]
    deliver(node, "/tf_static", TFMessage(transforms=edges))
    for side in ("left", "right"):
        info = CameraInfo(header=header(0, f"{side}_optical"), width=CAMERA.width, height=CAMERA.height)
        info.k, info.d = CAMERA.K.ravel(), [0.0] * 5
        deliver(node, f"{side}/camera_info", info)


def show(node: MapperNode, k: int) -> None:
    pixels = view(k).image
    image = Image(header=header(view(k).stamp_ns, "left_optical"), height=pixels.shape[0], width=pixels.shape[1])
    image.encoding, image.step, image.data = "mono8", pixels.shape[1], flat(pixels.ravel())
    deliver(node, "left/image_raw", image)


def locate(node: MapperNode, k: int) -> None:
    T_map_body = view(k).T_map_cam @ T_BODY_LEFT.inverse()
    message = pose_with_covariance_to_msg(PoseEstimate(view(k).stamp_ns, T_map_body, np.eye(6)), frame_id="uav1/map")
    deliver(node, "slam/smoothed", message)


def fly(node: MapperNode, frames: range) -> None:
    for k in frames:
        show(node, k)
        if k - LATE in frames:
            locate(node, k - LATE)
    for k in frames[-LATE:]:
        locate(node, k)


def save(node: MapperNode) -> Trigger.Response:
    return node._on_save(Trigger.Request(), Trigger.Response())


def test_the_saved_map_is_that_of_the_core(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(VIEWS))
    response = save(node)
    assert response.success, response.message
    reference = HeightGrid(1.0)
    mapper = SurfaceMapper(reference)
    for k in range(VIEWS):
        mapper.add_view(view(k))
    found = HeightGrid.open(tmp_path / "map" / "tiles")
    ours, theirs = (grid.height(reference.extent) for grid in (found, reference))
    assert np.mean(np.isfinite(ours) == np.isfinite(theirs)) > 0.99  # poses are rounded on their way
    assert np.nanmedian(np.abs(ours - theirs)) < 1e-4
    assert node.counts["views"] == VIEWS
    assert (tmp_path / "map" / "height.tif").is_file()
    tree = json.loads((tmp_path / "map" / "map.json").read_text())
    assert (tree["frame"], tree["north_up"]) == (node.map_frame, True)


def test_in_flight_only_tiles_are_saved_and_the_rest_at_the_end(make: Make, tmp_path: Path) -> None:
    folder = tmp_path / "map"
    node = make(f"map.folder:={folder}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(VIEWS))
    node._publish()
    assert {path.name.partition("_")[0] for path in folder.iterdir()} == {"tiles", "mosaic"}
    assert HeightGrid.open(folder / "tiles").extent == node._map.grid.extent
    assert finish(node) == 0
    picture = {f"orthomosaic.{suffix}" for suffix in ("png", "pgw", "jpg")}
    assert {path.name for path in folder.iterdir()} == {"tiles", "map.json", "height.tif"} | picture


def test_after_a_long_publication_tiles_are_saved_but_the_map_is_published_only_later(
    make: Make, tmp_path: Path
) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(VIEWS))
    node._idle_until_s = math.inf
    node._publish()
    assert node.notes["map"].endswith(f"tiles from {node._map.mapper.pairs} pairs")
    assert node._published_pairs == 0
    node._idle_until_s = 0.0
    node._publish()
    assert node._published_pairs == node._map.mapper.pairs > 0
    assert node._idle_until_s > 0.0


def test_a_map_without_a_folder_is_published_only(make: Make) -> None:
    node = make("map.cell_m:=1.0", "map.publish_s:=0.1")
    clouds: list[PointCloud2] = []
    meshes: list[Marker] = []
    other = rclpy.create_node("other", use_global_arguments=False)
    other.create_subscription(PointCloud2, "/uav1/map/surface", clouds.append, LATCHED)
    other.create_subscription(Marker, "/uav1/map/mesh", meshes.append, LATCHED)
    executor = rclpy.executors.SingleThreadedExecutor()
    for each in (node, other):
        executor.add_node(each)

    def spin(until: Callable[[], object]) -> bool:
        return wait_for(until, lambda: executor.spin_once(timeout_sec=0.02))

    try:
        assert spin(lambda: node._surface.get_subscription_count() and node._mesh.get_subscription_count())
        calibrate(node)
        fly(node, range(LONGER))
        assert spin(lambda: clouds and meshes)
    finally:
        executor.shutdown()
        other.destroy_node()
    points = np.frombuffer(clouds[-1].data, np.float32).reshape(-1, 4)
    assert len(points) > 1000
    blue = points[:, 3].copy().view(np.uint8)[::4]
    coloured = blue != UNSEEN_GREY
    assert coloured.mean() > 0.2  # the others wait for their surroundings
    assert np.corrcoef(blue[coloured], ground().grey(points[coloured, 0], points[coloured, 1]))[0, 1] > 0.8
    assert np.median(np.abs(points[:, 2] - ground().relief.height(points[:, 0], points[:, 1]))) < 0.1
    corners = np.array([[point.x, point.y, point.z] for point in meshes[-1].points])
    assert len(corners) % 3 == 0
    assert np.median(np.abs(corners[:, 2] - ground().relief.height(corners[:, 0], corners[:, 1]))) < 0.1
    assert meshes[-1].header.frame_id == clouds[-1].header.frame_id == "uav1/map"
    response = save(node)
    assert not response.success
    assert "map.folder is empty" in response.message


def test_images_and_poses_without_a_partner_are_counted(make: Make) -> None:
    node = make()
    calibrate(node)
    show(node, 1)
    show(node, 2)
    locate(node, 2)
    assert node.counts["dropped/image_without_pose"] == 1
    locate(node, 3)
    assert node.counts["dropped/pose_without_image"] == 1
    assert node.counts["views"] == 1


def test_images_wait_for_the_calibration(make: Make) -> None:
    """The first one may come with it, in any order: none is lost in a healthy start."""
    node = make()
    for k in range(VIEWS):
        show(node, k)
    calibrate(node)
    for k in range(VIEWS):
        locate(node, k)
    assert node.counts["views"] == VIEWS
    assert not any(name.startswith("dropped/") and count for name, count in node.counts.items())


def test_a_pose_before_the_calibration_is_dropped(make: Make) -> None:
    node = make()
    show(node, 0)
    locate(node, 0)
    assert node.counts["dropped/no_calibration"] == 1
    calibrate(node)
    fly(node, range(1, VIEWS))
    assert node.counts["views"] == VIEWS - 1


def test_a_calibration_from_files_alone_makes_a_map(make: Make, tmp_path: Path) -> None:
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy],
        "distortion_model": "radtan",
        "distortion_coeffs": [0.0] * 4,
        "resolution": [CAMERA.width, CAMERA.height],
    }
    beside = Pose(np.eye(3), np.array([0.0, -0.8, 0.0]))
    chain = {
        "cam0": camera | {"T_cam_imu": T_BODY_LEFT.inverse().matrix.tolist()},
        "cam1": camera | {"T_cn_cnm1": beside.matrix.tolist()},
    }
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(chain))
    node = make(f"input.calibration:=[{tmp_path / 'camchain.yaml'}]")
    fly(node, range(VIEWS))
    assert node.counts["views"] == VIEWS


def test_a_folder_that_holds_a_map_is_refused(make: Make, tmp_path: Path) -> None:
    HeightGrid(1.0, tmp_path / "map" / "tiles").flush()
    with pytest.raises(Exception, match="already holds a height grid"):
        make(f"map.folder:={tmp_path / 'map'}")


def test_a_folder_in_a_place_where_nothing_can_be_made_is_refused(make: Make, tmp_path: Path) -> None:
    (tmp_path / "disk").write_text("a file, no folder")
    with pytest.raises(BagError, match="map: can't be made"):
        make(f"map.folder:={tmp_path / 'disk' / 'map'}")


def test_a_restarted_mapper_and_a_reset_one_begin_a_map_beside_the_earlier_ones(make: Make, tmp_path: Path) -> None:
    HeightGrid(1.0, tmp_path / "map" / "tiles").flush()
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0", "resume:=true")
    assert node._map.folder == tmp_path / "map_2"
    HeightGrid(1.0, tmp_path / "map_3" / "tiles").flush()
    calibrate(node)
    fly(node, range(VIEWS))
    node.reset()
    assert (tmp_path / "map_2" / "map.json").is_file()
    assert node._map.folder == tmp_path / "map_4"


def found(node: MapperNode, stamp_ns: int) -> None:
    state = NavEstimate(NavState(stamp_ns, Pose.identity(), *np.zeros((3, 3))), np.eye(15))
    deliver(node, "initial_state", navigation_to_msg(state, frame_id="uav1/map", child_frame_id="uav1/base_link"))


def test_another_start_in_flight_begins_another_map(make: Make, tmp_path: Path) -> None:
    """Its poses are in another frame; the same start, latched by a node that was restarted, begins none."""
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0", "start.method:=in_flight")
    calibrate(node)
    for stamp_ns, folder in ((5, "map"), (5, "map"), (7, "map_2")):
        found(node, stamp_ns)
        assert node._map.folder == tmp_path / folder
        fly(node, range(VIEWS))
    assert (tmp_path / "map" / "map.json").is_file()
    with full_disk():
        found(node, 9)
    assert node._map.folder is None
    assert "File too large" in node.alarms["map"]


def test_a_reset_and_the_start_found_after_it_begin_one_map_together(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0", "start.method:=in_flight")
    calibrate(node)
    found(node, 5)
    fly(node, range(VIEWS))
    node.reset()
    found(node, 7)
    assert node._map.folder == tmp_path / "map_2"
    assert sorted(folder.name for folder in tmp_path.iterdir()) == ["map", "map_2"]


def test_where_the_start_is_given_each_map_frame_is_the_same(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    assert not any(one.topic == "initial_state" for one in node._inputs)


def test_a_reset_that_can_not_begin_another_map_leaves_the_present_one_in_use(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(VIEWS // 2))
    present = node._map
    with full_disk():
        response = node._on_reset(Trigger.Request(), Trigger.Response())
    assert not response.success
    assert "File too large" in response.message
    assert node._map is present
    fly(node, range(VIEWS // 2, VIEWS))
    assert finish(node) == 0
    assert (tmp_path / "map" / "orthomosaic.png").is_file()


def test_a_cleanup_that_can_not_begin_another_map_fails_and_the_node_can_be_activated(
    make: Make, tmp_path: Path
) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(VIEWS // 2))
    present = node._map
    node.trigger_deactivate()
    with full_disk():
        assert node.trigger_cleanup() == TransitionCallbackReturn.FAILURE
    assert node._map is present
    assert node.paused == INACTIVE
    node.trigger_activate()
    assert not node.paused


def test_a_full_disk_costs_views_and_not_the_node(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    node._map.grid._tiles._most_tiles = 1  # others are written to make room
    calibrate(node)
    fly(node, range(3))
    with full_disk():
        fly(node, range(3, VIEWS))
        node._publish()
    assert "File too large" in node.alarms["map"]
    assert node.counts["dropped/unsaved"] > 0
    mapped = node.counts["views"]
    fly(node, range(VIEWS, VIEWS + 3))
    assert node.counts["views"] == mapped + 3
    node._publish()
    assert "map" not in node.alarms


def test_a_map_that_can_not_be_saved_at_the_end_is_no_success(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(VIEWS))
    with full_disk():
        assert node.finish() == 1


def test_tiles_that_are_gone_cost_the_picture_and_not_the_node(make: Make, tmp_path: Path) -> None:
    node = make(f"map.folder:={tmp_path / 'map'}", "map.cell_m:=1.0")
    calibrate(node)
    fly(node, range(LONGER))
    tiles = node._map._drawn.tiles
    tiles.flush()
    tiles._cached.clear()
    for file in tmp_path.rglob("*.bin"):
        file.unlink()
    node.create_subscription(PointCloud2, "map/surface", lambda _: None, LATCHED)
    assert wait_for(lambda: node._surface.get_subscription_count() > 0)
    node._publish()
    assert "of the mosaic can't be read" in node.alarms["map"]


def test_a_folder_may_be_under_home(make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No shell expands ~ after `:=`."""
    monkeypatch.setenv("HOME", str(tmp_path))
    assert make("map.folder:=~/map")._map.folder == tmp_path / "map"


@contextmanager
def full_disk() -> Iterator[None]:
    """Let no file grow: the kernel refuses each write, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
