# SPDX-License-Identifier: Apache-2.0
"""What the tests share: recordings outside the repository, repeatable property tests, made-up beliefs, a node graph."""

import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import ArrayLike, NDArray

from uav_vslam.geometry.pose import Pose
from uav_vslam.types import JointInformation

# The same examples every time, no file beside the code, and no deadline: a busy host is no failure.
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.register_profile("thorough", max_examples=1000, database=None, deadline=None)  # --hypothesis-profile=thorough
settings.load_profile("repeatable")

ROOT = Path(__file__).parents[1]


def _data_root() -> Path:
    return Path(os.environ.get("UAV_VSLAM_DATA", ROOT / "../shared/data")).resolve()


def pytest_configure() -> None:
    """Let processes that tests start be interrupted where a shell's background job, which ignores SIGINT, runs them."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Have half as many workers again as cores: much of their time, node graphs wait for one another."""
    cores = len(os.sched_getaffinity(0))
    return cores + cores // 2


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let workers begin with the longest files, and skip what needs recordings that are not there."""
    if hasattr(config, "workerinput"):  # one of several workers: none is to be left alone with a long file at the end
        long = {item.path for item in items if item.get_closest_marker("slow")}
        items.sort(key=lambda item: item.path not in long)
    if _data_root().is_dir():
        return
    skip = pytest.mark.skip(reason="UAV_VSLAM_DATA names no folder with the shared recordings")
    for item in items:
        if item.get_closest_marker("data"):
            item.add_marker(skip)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the shared recordings; a test that uses it carries the marker `data`."""
    return _data_root()


@pytest.fixture(scope="session", autouse=True)
def _own_state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the numbers of the tests' sessions out of the user's home, for the processes that they start too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


def _descriptors(identities: ArrayLike) -> NDArray[np.uint8]:
    """Return (N, 128) descriptors; an identity has the same descriptor for every vehicle."""
    descriptors = [np.random.default_rng(int(k)).integers(0, 256, 128, np.uint8) for k in np.atleast_1d(identities)]
    return np.array(descriptors, np.uint8).reshape(-1, 128)


@pytest.fixture(scope="session")
def make_joint() -> Callable[..., JointInformation]:
    """Return a maker of beliefs over a pose and landmarks, from positions (N, 3) and a covariance (6+3N, 6+3N).

    `identities` say which landmarks of two vehicles are the same; by default they are the row numbers.
    """

    def make(
        positions: ArrayLike,
        covariance: ArrayLike,
        *,
        vehicle: str = "uav1",
        session: int = 1,
        stamp_ns: int = 10_000_000_000,
        T_map_body: Pose | None = None,
        identities: ArrayLike | None = None,
    ) -> JointInformation:
        points = np.asarray(positions, dtype=float).reshape(-1, 3)
        Y = np.linalg.inv(np.asarray(covariance, dtype=float))
        return JointInformation(
            stamp_ns=stamp_ns,
            vehicle=vehicle,
            session=session,
            T_map_body=T_map_body or Pose(np.eye(3), np.array([0.0, 0.0, 70.0])),
            ids=np.arange(1, len(points) + 1, dtype=np.uint32),
            positions=points,
            information=0.5 * (Y + Y.T),
            descriptors=_descriptors(range(len(points)) if identities is None else identities),
        )

    return make


@pytest.fixture
def make_domain_id() -> Iterator[Callable[[], int]]:
    """Return a maker of ROS domains that nobody else uses before the test ends."""
    from uav_vslam.ros.domain import claimed_domain

    with ExitStack() as claims:
        yield lambda: claims.enter_context(claimed_domain())


@pytest.fixture
def domain_id(make_domain_id: Callable[[], int]) -> int:
    """Return a ROS domain of the test's own."""
    return make_domain_id()


MARK = "UAV_VSLAM_TEST_RUN"  # in the environment of a launcher and so of all that it starts


@dataclass(frozen=True)
class Graph:
    """A fleet's node graph, started by `uav-vslam launch` on a ROS domain of its own.

    Attributes:
        process: the launcher; its output and that of the nodes are in one pipe.
        domain_id: its ROS domain.
        mark: value of `MARK` by which its processes are found.
    """

    process: subprocess.Popen[str]
    domain_id: int
    mark: str

    def alive(self) -> bool:
        """Whether the launcher runs."""
        return self.process.poll() is None

    def running(self) -> list[str]:
        """Command lines of the launcher and of whatever it started, as far as they live."""
        return list(self._processes().values())

    def pid_of(self, node: str) -> int:
        """Return the process of a node such as "uav1/fusion"."""
        namespace, name = node.split("/")
        wanted = f"__node:={name} -r __ns:=/{namespace} "
        return next(pid for pid, command in self._processes().items() if wanted in command)

    def _processes(self) -> dict[int, str]:
        needle, found = f"{MARK}={self.mark}".encode(), {}
        for process in Path("/proc").iterdir():
            try:
                if process.name.isdigit() and needle in (process / "environ").read_bytes():
                    found[int(process.name)] = (process / "cmdline").read_text().replace("\0", " ")
            except OSError:  # gone, or not ours
                continue
        return found


@contextmanager
def _launched(*arguments: str) -> Iterator[Graph]:
    """Run `uav-vslam launch`; whatever a failing test leaves is killed."""
    from uav_vslam.ros.domain import claimed_domain

    with claimed_domain() as domain_id:
        mark = uuid.uuid4().hex
        command = [sys.executable, "-m", "uav_vslam.cli.main", "launch", *arguments, "--domain", str(domain_id)]
        with subprocess.Popen(
            command, env=os.environ | {MARK: mark}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            try:
                yield Graph(process, domain_id, mark)
            finally:
                ended_itself = process.poll()
                process.kill()  # takes the nodes with it
                if ended_itself and process.stdout is not None and not process.stdout.closed:
                    print(process.stdout.read())  # why it did, below a failed test


@pytest.fixture(scope="session")
def launched() -> Callable[..., AbstractContextManager[Graph]]:
    """What starts a node graph: `with launched("fleet.yaml") as graph`."""
    return _launched
