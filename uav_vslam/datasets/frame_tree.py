# SPDX-License-Identifier: Apache-2.0
"""The static frames of a vehicle, as /tf_static holds them, or /tf where they never move."""

from collections.abc import Iterable

import numpy as np

from uav_vslam.errors import CalibrationError
from uav_vslam.geometry.pose import Pose

TF, TF_STATIC = "/tf", "/tf_static"  # topics
SAME_PLACE = 1e-4  # largest difference of two poses that are the same [m], and of their rotation matrices


Edge = tuple[str, str, Pose]  # parent frame, child frame, T_parent_child


class FrameTree:
    """Frames by name, each with its parent; names without a leading slash."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Pose]] = {}  # child -> (parent, T_parent_child)
        self._earlier: dict[tuple[str, str], Pose] = {}  # (parent, child) -> T_parent_child, replaced since
        self.borrowed: set[str] = set()  # frames that `borrow` has placed
        self.faults: dict[str, None] = {}  # what is wrong with edges that were left out

    def add(self, edges: Iterable[Edge], faults: Iterable[str] = ()) -> None:
        """Add edges (parent frame, child frame, T_parent_child); a later one replaces an earlier one.

        Args:
            edges: those that are valid.
            faults: what is wrong with the others.
        """
        self.faults |= dict.fromkeys(faults)
        for parent, child, pose in edges:
            before, T = self._parents.get(child, (parent, pose))
            if before != parent or not _same_place(T, pose):
                self._earlier[before, child] = T
            self._parents[child] = parent, pose

    @property
    def moved(self) -> set[str]:
        """Frames that a later edge has placed elsewhere; one below another parent may be where it was."""
        return {
            child
            for (parent, child), T in self._earlier.items()
            if not self.connected(parent, child) or not _same_place(self.find(parent, child), T)
        }

    @property
    def held(self) -> str:
        """All edges in words, by their children."""
        return ", ".join(f"{parent} -> {child}" for child, (parent, _) in sorted(self._parents.items())) or "nothing"

    def borrow(self, edges: Iterable[Edge]) -> None:
        """Add the edges of frames that have no place here yet."""
        for parent, child, pose in edges:
            if child not in self._parents:
                self._parents[child] = parent, pose
                self.borrowed.add(child)

    def __contains__(self, frame: str) -> bool:
        """Return whether any edge has a frame."""
        frame = frame.lstrip("/")
        return frame in self._parents or any(frame == parent for parent, _ in self._parents.values())

    def connected(self, base: str, frame: str) -> bool:
        """Return whether `find` would succeed."""
        return self._root(base)[0] == self._root(frame)[0]

    def body_of(self, frames: Iterable[str]) -> str:
        """Return the frame that sensors are mounted on: the base_link of their tree, or its root; empty without one."""
        roots = {self._root(frame)[0] for frame in frames}
        tree = sorted({parent for parent, _ in self._parents.values() if {self._root(parent)[0]} == roots})
        called_so = (frame for frame in tree if frame.rsplit("/", 1)[-1] == "base_link")
        return next(called_so, roots.pop() if tree else "")

    def find(self, base: str, frame: str) -> Pose:
        """Return T_base_frame.

        Raises:
            CalibrationError: the frames are not connected.
        """
        base, frame = base.lstrip("/"), frame.lstrip("/")
        base_root, T_root_base = self._root(base)
        root, T_root_frame = self._root(frame)
        if root == base_root:
            return T_root_base.inverse() @ T_root_frame
        held = self.held + (f" ({', '.join(self.faults)})" if self.faults else "")
        raise CalibrationError(
            f"/tf_static does not connect {base} and {frame or 'a frame without a name'}; it holds {held}. "
            f"Publish that transform, name the frames by input.frames, or give a file with input.calibration"
        )

    def loop(self, frame: str) -> list[str]:
        """Return the frames of the loop that a frame is in or below, child first and its first one again last."""
        frame, seen = frame.lstrip("/"), list[str]()
        while frame in self._parents and frame not in seen:
            seen.append(frame)
            frame = self._parents[frame][0]
        return [*seen[seen.index(frame) :], frame] if frame in seen else []

    def _root(self, frame: str) -> tuple[str, Pose]:
        """Return the frame's topmost ancestor, and the frame's pose there."""
        frame, pose, seen = frame.lstrip("/"), Pose.identity(), set[str]()
        while frame in self._parents and frame not in seen:  # a loop has no root: its frames stay apart
            seen.add(frame)
            parent, T_parent_child = self._parents[frame]
            frame, pose = parent, T_parent_child @ pose
        return frame, pose


class UnmovedFrames:
    """The frames of /tf that never move: `static_transform_publisher` of ROS 1's `tf` repeats constant edges there."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[str, Pose]] = {}  # child -> (parent, T_parent_child)
        self._moved: set[str] = set()

    def add(self, edges: Iterable[Edge]) -> None:
        """Add edges (parent frame, child frame, T_parent_child) of one message."""
        for parent, child, pose in edges:
            if child not in self._moved:
                before, T = self._first.setdefault(child, (parent, pose))
                if before != parent or not _same_place(T, pose):
                    self._moved.add(child)

    @property
    def edges(self) -> list[Edge]:
        """The edges that were always the same."""
        return [(parent, child, T) for child, (parent, T) in self._first.items() if child not in self._moved]


def _same_place(one: Pose, other: Pose) -> bool:
    return np.allclose(one.matrix, other.matrix, atol=SAME_PLACE)
