# SPDX-License-Identifier: Apache-2.0
"""The folder tree is the block diagram: who may import whom, and where each outside library stays at home."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "uav_vslam"

# What each part may import, beside itself and `errors`; the EARLY ones may be used by all.
EARLY = {"types", "yaml_text", "config", "geometry", "numerics", "search", "stamps"}
ESTIMATOR = EARLY | {"ins", "estimation", "vision", "association", "slam", "cooperation"}
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "types": {"geometry", "numerics"},  # a record holds a Pose, and keeps the inverse of its information
    "yaml_text": set(),
    "config": {"yaml_text"},
    "stamps": {"types"},
    "geometry": set(),
    "numerics": set(),
    "search": set(),
    "argument_types": {"config"},
    "monitor": set(),  # what is heard of a live fleet
    "memory": set(),
    "processes": {"memory"},
    # the estimator, in its order
    "ins": EARLY,
    "estimation": EARLY | {"ins"},  # the filter predicts by increments
    "vision": EARLY,
    "association": EARLY | {"estimation", "vision"},
    "slam": EARLY | {"ins", "estimation", "vision", "association"},
    "cooperation": EARLY | {"estimation", "vision", "association", "slam"},
    "pipeline": ESTIMATOR,
    "fleet": ESTIMATOR | {"pipeline"},
    "smoothing": EARLY | {"ins", "estimation", "slam"},  # a finished flight; the estimator does not know it
    "mapping": EARLY | {"vision", "evaluation"},  # images and poses, from anywhere; the datum of its files
    # the side branches
    "simulation": EARLY | {"datasets"},  # a simulated flight is recorded as a bag
    "evaluation": EARLY | {"estimation"},
    # recorded truth becomes a trajectory, readings move to the body, images show which legs overlap
    "datasets": EARLY | {"evaluation", "ins", "vision", "argument_types"},
    "calibration": EARLY | {"vision", "datasets"},  # image pairs of files and recordings
    "report": {"types", "yaml_text", "geometry", "evaluation", "calibration", "monitor"},
    "overlay": ESTIMATOR | {"pipeline"},  # pictures of what the pipeline found
    "inspection": EARLY | {"ins", "vision", "datasets"},  # it judges what `datasets` reads, by what the graph allows
    # what puts them together without ROS
    "offline": ESTIMATOR | {"pipeline", "fleet", "smoothing", "evaluation", "processes"},
    "studies": ESTIMATOR
    | {"pipeline", "fleet", "offline", "processes", "evaluation", "report"}
    | {"datasets", "simulation", "calibration", "mapping", "argument_types"},
    # the top
    "ros": ESTIMATOR | {"pipeline", "fleet", "datasets", "mapping", "processes", "memory", "monitor"},
    "cli": ESTIMATOR
    | {"pipeline", "fleet", "datasets", "inspection", "calibration", "evaluation", "simulation", "report"}
    | {"overlay", "offline", "mapping", "memory", "monitor", "argument_types"},
}
# What starts or watches ROS processes may import `ros`.
ROS_STARTERS = {"cli/launch.py", "cli/demo.py", "cli/topic.py", "cli/mode.py", "cli/monitor.py"}
ROS_STARTERS |= {"studies/engine/node_graph.py", "cli/bench.py"}
# What the command line takes from the laboratory; nothing else of the product knows it.
LABORATORY_DOORS = {"cli/study.py", "cli/bench.py"}

MESSAGES = "messages of ROS"
AT_HOME = {
    "cv2": {"vision", "datasets", "simulation", "calibration", "overlay", "mapping"},
    "rclpy": {"ros"},
    "std_srvs": {"ros"},
    "rosbags": {"datasets"},
    "mcap": {"datasets"},
    "gtsam": {"studies"},  # a reference, no part of the estimator
    "matplotlib": {"report", "studies"},
    "PIL": {"report", "mapping"},
    "tifffile": {"mapping"},
    "trimesh": {"mapping"},
    "fast_simplification": {"mapping"},
    "pyproj": {"evaluation"},  # geodetic coordinates of exported trajectories
    MESSAGES: {"ros"},
}
# OpenCV inverts lens models. cv2.setNumThreads(1) belongs where a process begins; the bench compares with OpenCV.
AT_HOME_FILES = {
    "rosbags": {
        "studies/recordings/ros1.py",  # writes what strangers record
        "studies/bench/recordings.py",  # reads without us, as the reference
    },
    "cv2": {
        "geometry/camera.py",
        "offline/track.py",
        "cli/calibrate.py",
        "cli/check.py",
        "cli/map.py",
        "cli/mosaic.py",
        "cli/simulate.py",
        "cli/bench.py",
        "studies/bench/compute.py",
        "studies/orthomosaic/displacement.py",  # measures
        "studies/orthomosaic/stitcher.py",  # the reference
        "studies/bench/recordings.py",
        "studies/surface/compute.py",
        "studies/surface/sparse.py",
        "ros/runtime.py",
    },
}


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def part_of(path: Path) -> str:
    part = path.relative_to(PACKAGE).with_suffix("").parts[0]
    return "cli" if part == "__main__" else part


@functools.cache
def imports_of(path: Path) -> list[tuple[str, int]]:
    """Return each absolute module that a file imports anywhere, in functions and for type checks too, and its line."""
    found: list[tuple[str, int]] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            assert node.module is not None
            if node.module == "uav_vslam":
                found += [(f"uav_vslam.{alias.name}", node.lineno) for alias in node.names]
            else:
                found.append((node.module, node.lineno))
    return found


def wrong_layers(path: Path) -> list[str]:
    part, found = part_of(path), []
    if part == "__init__":
        return [f"{path}:{line}: the package itself imports {name}" for name, line in imports_of(path)]
    allowed, inside = ALLOWED[part] | {part, "errors", "__version__"}, path.relative_to(PACKAGE).as_posix()
    if inside in ROS_STARTERS:
        allowed = allowed | {"ros"}
    if inside in LABORATORY_DOORS:
        allowed = allowed | {"studies"}
    for name, line in imports_of(path):
        top, _, rest = name.partition(".")
        if top == "uav_vslam" and rest.partition(".")[0] not in allowed:
            found.append(f"{path.relative_to(ROOT)}:{line}: {part} must not import {name}")
    return found


def library_of(name: str) -> str:
    top = name.partition(".")[0]
    return MESSAGES if top.endswith(("_msgs", "_interfaces")) else top


def strays(path: Path) -> list[str]:
    part, inside, found = part_of(path), path.relative_to(PACKAGE).as_posix(), []
    for name, line in imports_of(path):
        library = library_of(name)
        if library in AT_HOME and part not in AT_HOME[library] and inside not in AT_HOME_FILES.get(library, set()):
            found.append(f"{path.relative_to(ROOT)}:{line}: {name} belongs into {', '.join(sorted(AT_HOME[library]))}")
    return found


def neighbours(path: Path) -> list[str]:
    """Return a study's imports of another study; the registry alone knows them all."""
    parts = path.relative_to(PACKAGE).parts
    if parts[0] != "studies" or len(parts) < 3:
        return []
    shared = {"studies", f"studies.{parts[1]}", "studies.engine"}
    return [
        f"{path.relative_to(ROOT)}:{line}: {name} is of another study"
        for name, line in imports_of(path)
        if name.startswith("uav_vslam.studies") and ".".join(name.split(".")[1:3]) not in shared
    ]


CHECKS = {"layers": wrong_layers, "libraries": strays, "studies": neighbours}


def test_every_part_of_the_package_has_its_place_in_the_order() -> None:
    parts = {part_of(path) for path in modules()} - {"__init__"}
    assert parts <= set(ALLOWED)


def test_the_list_for_contributors_has_every_part_and_may_be_read_downwards() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    lines = text.partition("## Layers")[2].partition("The core knows")[0].splitlines()
    listed = [line[4:].partition("   ")[0].replace("|", " ").split() for line in lines if line.startswith("    ")]
    rank = {part: row for row, parts in enumerate(listed) for part in parts}
    assert rank.keys() == ALLOWED.keys()
    assert [(part, below) for part, allowed in ALLOWED.items() for below in allowed if rank[below] > rank[part]] == []


@pytest.mark.slow
def test_later_layers_import_earlier_ones_and_never_the_reverse() -> None:
    assert [line for path in modules() for line in wrong_layers(path)] == []


def test_outside_libraries_stay_at_home() -> None:
    assert [line for path in modules() for line in strays(path)] == []


def test_a_study_imports_what_studies_share_and_no_other_study() -> None:
    assert [line for path in modules() for line in neighbours(path)] == []


def test_the_order_has_no_cycle() -> None:
    placed: set[str] = {"errors"}
    rest = {part: needs - {part} for part, needs in ALLOWED.items() if part != "errors"}
    while rest:
        ready = {part for part, needs in rest.items() if needs <= placed}
        assert ready, f"a cycle among {sorted(rest)}"
        placed |= ready
        rest = {part: needs for part, needs in rest.items() if part not in ready}


@pytest.mark.parametrize(
    ("place", "text", "wrong"),
    [
        ("geometry/pose.py", "from uav_vslam.slam.packet import validate", "layers"),
        ("estimation/filter.py", "def f():\n    import uav_vslam.vision.pnp", "layers"),
        ("slam/backend.py", "from uav_vslam import cooperation", "layers"),
        ("cli/run.py", "from uav_vslam.ros import convert", "layers"),
        ("ros/convert.py", "from uav_vslam.cli import main", "layers"),
        ("cli/run.py", "from uav_vslam.studies.engine.pool import mean", "layers"),
        ("report/style.py", "import uav_vslam.studies.registry", "layers"),
        ("studies/rig/compute.py", "from uav_vslam.studies.long.compute import SPAN", "studies"),
        ("slam/packet.py", "import cv2", "libraries"),
        ("pipeline.py", "from sensor_msgs.msg import Image", "libraries"),
        ("cooperation/inbox.py", "import rclpy.node", "libraries"),
        ("ros/recording.py", "from rosbags.highlevel import AnyReader", "libraries"),
    ],
)
def test_the_checks_notice_a_wrong_import(tmp_path: Path, monkeypatch, place: str, text: str, wrong: str) -> None:
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    monkeypatch.setattr(sys.modules[__name__], "PACKAGE", tmp_path)
    path = tmp_path / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    assert len(CHECKS[wrong](path)) == 1


@pytest.mark.parametrize(
    ("node", "needless"),
    [
        ("ins_propagator_node", "rosbags scipy"),
        ("stereo_frontend_node", "rosbags scipy.linalg scipy.spatial"),
        ("slam_backend_node", "rosbags scipy.spatial"),
        ("fusion_node", "rosbags networkx"),
        ("replay_node", "scipy"),
        ("mapper_node", "scipy"),
        ("link_emulator_node", "scipy.optimize"),
    ],
)
def test_a_killed_node_is_back_sooner_without_libraries_that_it_does_not_use(node: str, needless: str) -> None:
    script = f"import sys, uav_vslam.ros.{node}; print(*(set({needless.split()}) & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert not loaded.strip()


CORE = (
    "errors",
    "types",
    "yaml_text",
    "config",
    "stamps",
    "geometry",
    "ins",
    "estimation",
    "vision",
    "association",
    "slam",
    "cooperation",
)
CORE += (
    "pipeline",
    "fleet",
    "smoothing",
    "mapping",
    "simulation",
    "datasets",
    "inspection",
    "calibration",
    "evaluation",
    "report",
    "overlay",
    "offline",
)
CORE += ("overlay", "offline", "studies", "cli")

BLOCKED_IMPORT = """
import importlib, sys


class Refuse:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in {"rclpy", "rcl_interfaces", "builtin_interfaces"} or top.endswith("_msgs"):
            raise ImportError(f"{name} is blocked")


sys.meta_path.insert(0, Refuse())
for name in sys.argv[1:]:
    importlib.import_module(name)
print(len(sys.argv) - 1)
"""


@pytest.mark.slow
def test_everything_but_the_nodes_works_without_ros() -> None:
    """One process imports every module of the core with rclpy and all message packages refused."""
    names = [
        ".".join(("uav_vslam", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        for path in modules()
        if part_of(path) in CORE
    ]
    done = subprocess.run([sys.executable, "-c", BLOCKED_IMPORT, *names], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == len(names) > 40
