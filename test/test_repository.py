# SPDX-License-Identifier: Apache-2.0
"""The repository keeps its own promises: licences, versions, commented messages, nothing tied to one machine."""

import ast
import re
import subprocess
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

import uav_vslam

ROOT = Path(__file__).parents[1]
MESSAGES = sorted((ROOT / "uav_vslam_msgs" / "msg").glob("*.msg"))
TEXT_SUFFIXES = {".py", ".md", ".yaml", ".yml", ".toml", ".cfg", ".xml", ".msg", ".txt", ".in", ".cmake", ".sh", ""}


def tracked(pattern: str = "*") -> list[Path]:
    """Files that are in the repository or about to enter it."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", pattern]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return [ROOT / name for name in names if (ROOT / name).is_file()]


def setup_call() -> dict[str, ast.expr]:
    """Keyword arguments of the call to setup() in setup.py."""
    tree = ast.parse((ROOT / "setup.py").read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"]
    assert len(calls) == 1
    return {keyword.arg: keyword.value for keyword in calls[0].keywords if keyword.arg}


@pytest.mark.parametrize(
    ("folder", "name", "build_type", "licence"),
    [
        (".", "uav_vslam", "ament_python", "Apache-2.0"),
        ("uav_vslam_msgs", "uav_vslam_msgs", "ament_cmake", "Apache-2.0"),
        ("compat/tf2_msgs", "tf2_msgs", "ament_cmake", "BSD-3-Clause"),
    ],
)
def test_package_xml_is_valid_and_says_how_it_is_built(folder: str, name: str, build_type: str, licence: str) -> None:
    warnings: list[str] = []
    package = parse_package(str(ROOT / folder), warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []
    assert package.package_format == 3
    assert package.name == name
    assert [str(entry) for entry in package.licenses] == [licence]
    assert [export.content for export in package.exports if export.tagname == "build_type"] == [build_type]


def test_references_are_those_of_the_docstrings() -> None:
    """Each key is in the table, with the modules that cite it."""
    cited: dict[str, set[str]] = {}
    for path in tracked("uav_vslam/*.py"):
        for key in re.findall(r"\[([a-z]+\d\d|thesis)\]", path.read_text()):
            cited.setdefault(key, set()).add(path.relative_to(ROOT / "uav_vslam").as_posix())
    rows = re.findall(r"^\| (\w+) \| .* \| (.*) \|$", (ROOT / "REFERENCES.md").read_text(), re.MULTILINE)
    listed = {key: set(re.findall(r"`([\w/]+\.py)`", where)) for key, where in rows if key != "key"}
    listed["thesis"] = cited["thesis"]  # by most
    assert listed == cited


def test_versions_agree() -> None:
    versions = {
        "uav_vslam/__init__.py": uav_vslam.__version__,
        "setup.py": ast.literal_eval(setup_call()["version"]),
        "package.xml": parse_package(str(ROOT)).version,
        "uav_vslam_msgs/package.xml": parse_package(str(ROOT / "uav_vslam_msgs")).version,
    }
    assert len(set(versions.values())) == 1, versions


def test_every_message_is_built_and_none_is_missing() -> None:
    listed = re.findall(r"msg/(\w+\.msg)", (ROOT / "uav_vslam_msgs" / "CMakeLists.txt").read_text())
    assert sorted(listed) == [path.name for path in MESSAGES]


@pytest.mark.parametrize("path", MESSAGES, ids=lambda path: path.stem)
def test_every_message_field_says_what_it_holds(path: Path) -> None:
    fields = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    assert fields
    for line in fields:
        declaration, _, comment = line.partition("#")
        assert re.fullmatch(r"[\w/]+(\[\d*\])? \w+(=\d+)?\s*", declaration), line
        assert len(comment.split()) >= 2, f"{path.name}: no comment on {line!r}"


@pytest.mark.parametrize("suffix", [".py", ".msg"])
def test_every_source_file_names_its_licence_first(suffix: str) -> None:
    own = [path for path in tracked(f"*{suffix}") if "compat" not in path.relative_to(ROOT).parts]
    assert own
    tag = "# SPDX-License-Identifier: Apache-2.0\n"
    lines = {path: path.read_text().splitlines(keepends=True)[:2] for path in own}  # a program's first is its #!
    assert [path.relative_to(ROOT) for path, first in lines.items() if tag not in first] == []


def test_the_licence_is_apache_2() -> None:
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text
    assert "END OF TERMS AND CONDITIONS" in text


def test_no_file_is_tied_to_one_machine() -> None:
    folders = "|".join(["home", "root", "work", "Users", "tmp"])
    machine_path = re.compile(rf"(?<![\w./$}}{{-])/(?:{folders})/\w")
    texts = [path for path in tracked() if path.suffix in TEXT_SUFFIXES and path.name != "LICENSE"]
    assert texts
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in texts
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1)
        if machine_path.search(line)
    ]
    assert found == []


def anchors(page: str) -> set[str]:
    """What links can name in a Markdown page: its headings, as GitHub writes them."""
    headings = re.findall(r"^#+ (.*)", page, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_of_a_document_leads_to_a_file_and_a_heading() -> None:
    pages = {path: path.read_text() for path in tracked("*.md")}
    links = [(path, link) for path, page in pages.items() for link in re.findall(r"\]\(([^)\s]+)\)", page)]
    inside = [(path, *link.partition("#")[::2]) for path, link in links if "://" not in link]
    assert inside
    for path, name, anchor in inside:
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), f"{path.name}: {name}"
        assert not anchor or anchor in anchors(pages[target]), f"{path.name}: {name}#{anchor}"


def test_every_requirement_in_a_lock_is_hashed_and_pinned() -> None:
    for lock in sorted((ROOT / "requirements").glob("*.txt")):
        requirements = re.findall(r"^([A-Za-z0-9].*?)(?=^[A-Za-z0-9]|\Z)", lock.read_text(), re.MULTILINE | re.DOTALL)
        assert requirements, lock.name
        for requirement in requirements:
            assert re.match(r"[\w.\[\],-]+==[\w.]+", requirement), f"{lock.name}: {requirement[:60]!r} is not pinned"
            assert "--hash=sha256:" in requirement, f"{lock.name}: {requirement[:60]!r} has no hash"


def test_jazzy_and_pypi_environments_have_the_same_versions() -> None:
    def pins(name: str) -> dict[str, str]:
        lines = (ROOT / "requirements" / name).read_text().splitlines()
        return dict(line.split(" \\")[0].split("==", 1) for line in lines if re.match(r"[\w.-]+==", line))

    everything, jazzy = pins("lock.txt"), pins("lock-jazzy.txt")
    assert jazzy.items() <= everything.items()
    assert not [name for name in jazzy if name.startswith(("ros-", "colcon-"))]


def test_only_the_command_is_put_on_path_and_the_nodes_where_ros2_run_looks() -> None:
    scripts = ast.literal_eval(setup_call()["entry_points"])["console_scripts"]
    names = {entry.split(" = ")[0] for entry in scripts}
    nodes = {
        "replay",
        "stereo_frontend",
        "ins_propagator",
        "slam_backend",
        "fusion",
        "mapper",
        "recorder",
        "link_emulator",
    }
    assert names == nodes | {"uav-vslam"}
    assert "install_scripts=$base/lib/uav_vslam" in (ROOT / "setup.cfg").read_text()
    assert [path.name for path in (ROOT / "bin").iterdir()] == ["uav-vslam"]
