# SPDX-License-Identifier: Apache-2.0
"""Calibration boards and their corners in an image, by OpenCV.

The board's frame: x along its columns, y along its rows, the first inner corner at the origin.
"""

from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from uav_vslam.errors import CalibrationError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SMALLEST = 3  # corners along a side that OpenCV's chessboard detector needs
LEAST_SHARE = 0.3  # of a ChArUco board's corners: fewer do not determine its pose well
HOMOGRAPHY_RANK, LEAST_SINGULAR = 8, 1e-6  # of the equations for a homography; the least value relative to the largest
LEAST_REACH, LARGEST_REACH = 2, 5  # pixels each way in which a corner is refined
BLURRED = 1.5  # pixels over which an edge reaches
SUBPIXEL_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
DICTIONARIES = sorted(name for name in vars(cv2.aruco) if name.startswith("DICT_"))


@dataclass(frozen=True, slots=True)
class Corners:
    """Corners of a board seen in one image.

    Attributes:
        points_board: (N, 3) on the board [m].
        pixels: (N, 2) in the image as recorded, with lens distortion.
    """

    points_board: Array
    pixels: Array

    @property
    def fix_pose(self) -> bool:
        """Whether they fix the board's pose: four or more, and more than one beside those in any line.

        That is so if they fix a homography: the linear equations for its nine numbers then have rank 8.
        """
        if 2 * len(self.points_board) < HOMOGRAPHY_RANK:
            return False
        xy = self.points_board[:, :2] - self.points_board[:, :2].mean(axis=0)
        x, y = xy.T / max(float(np.abs(xy).max()), 1e-12)
        one, zero = np.ones_like(x), np.zeros_like(x)
        A = np.vstack(
            [
                np.stack([x, y, one, zero, zero, zero, -x * x, -x * y, -x], axis=1),
                np.stack([zero, zero, zero, x, y, one, -x * y, -y * y, -y], axis=1),
            ]
        )
        singular = np.linalg.svd(A, compute_uv=False)
        return bool(singular[HOMOGRAPHY_RANK - 1] > LEAST_SINGULAR * singular[0])


class Board(Protocol):
    """What can be found in an image; `ADVICE` says what to check where it is not."""

    ADVICE: ClassVar[str]

    @property
    def columns(self) -> int:
        """Inner corners along x."""

    @property
    def rows(self) -> int:
        """Inner corners along y."""

    @property
    def square_m(self) -> float:
        """Side of a square [m]."""

    def detect(self, image: Image) -> Corners | None:
        """Return the corners in an (H, W) image, or None if the board is not found."""

    def size_in(self, image: Image) -> tuple[int, int] | None:
        """Return the inner corners of any such board in an image, the longer side first; None where that is unknown."""

    def like(self, corners: Corners, reference: Corners) -> Corners:
        """Return the corners, counted as in the other camera's image where the board's symmetry leaves that open."""


@dataclass(frozen=True, slots=True)
class Chessboard:
    """A chessboard of `columns` x `rows` inner corners, seen as a whole."""

    ADVICE: ClassVar[str] = "--board counts inner corners, one fewer than squares each way"
    columns: int
    rows: int
    square_m: float

    def __post_init__(self) -> None:
        _check(self.columns, self.rows, self.square_m)

    def detect(self, image: Image) -> Corners | None:
        """See `Board`."""
        found, pixels = cv2.findChessboardCornersSB(image, (self.columns, self.rows), flags=cv2.CALIB_CB_EXHAUSTIVE)
        return Corners(_grid(self), _sharpened(image, pixels, 0.4)) if found else None

    def size_in(self, image: Image) -> tuple[int, int] | None:
        """See `Board`."""
        found, _, meta = cv2.findChessboardCornersSBWithMeta(image, (SMALLEST, SMALLEST), cv2.CALIB_CB_LARGER)
        return (max(meta.shape), min(meta.shape)) if found else None

    def like(self, corners: Corners, reference: Corners) -> Corners:
        """See `Board`: a board that looks the same when turned is counted along the reference's directions."""
        grid = corners.pixels.reshape(self.rows, self.columns, 2)
        candidates = [np.rot90(grid, turns) for turns in self._symmetries()]
        centred = reference.pixels - reference.pixels.mean(axis=0)
        best = max(candidates, key=lambda turned: float(np.sum(turned.reshape(-1, 2) * centred)))
        return Corners(corners.points_board, np.ascontiguousarray(best).reshape(-1, 2))

    def _symmetries(self) -> list[int]:
        """Return the quarter turns that map the board's colours onto themselves."""
        if (self.columns + self.rows) % 2 == 1:
            return [0]
        return [0, 1, 2, 3] if self.columns == self.rows else [0, 2]


@dataclass(frozen=True, slots=True)
class Charuco:
    """A chessboard with ArUco markers in its white squares, of which a part suffices.

    Attributes:
        columns, rows: inner corners.
        square_m, marker_m: sides of a square and of a marker [m].
        dictionary: OpenCV's name of the markers, "DICT_5X5_100".
        legacy: first square of boards made by OpenCV before 4.6.
    """

    ADVICE: ClassVar[str] = "--board counts inner corners; is it this --charuco dictionary, or a --legacy board?"
    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False
    _detector: "cv2.aruco.CharucoDetector" = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        _check(self.columns, self.rows, self.square_m)
        if self.dictionary not in DICTIONARIES:
            raise CalibrationError(f"dictionary {self.dictionary!r} is not known; use one of {', '.join(DICTIONARIES)}")
        if not 0 < self.marker_m < self.square_m:
            raise CalibrationError(f"marker of {self.marker_m} m must be smaller than its square of {self.square_m} m")
        markers = ((self.columns + 1) * (self.rows + 1)) // 2
        known = len(self._markers().bytesList)
        if markers > known:
            raise CalibrationError(
                f"a ChArUco board of {self.columns}x{self.rows} inner corners has {markers} markers, but "
                f"{self.dictionary} only {known}; is it the right dictionary?"
            )
        object.__setattr__(self, "_detector", cv2.aruco.CharucoDetector(self.drawing()))

    def drawing(self) -> "cv2.aruco.CharucoBoard":
        """Return OpenCV's board, which can draw itself."""
        size = self.columns + 1, self.rows + 1
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, self._markers())
        board.setLegacyPattern(self.legacy)
        return board

    def detect(self, image: Image) -> Corners | None:
        """See `Board`."""
        pixels, ids, _, _ = self._detector.detectBoard(image)
        if ids is None or len(ids) < LEAST_SHARE * self.columns * self.rows:
            return None
        clear = 0.5 * (1.0 - self.marker_m / self.square_m)
        return Corners(_grid(self)[np.ravel(ids)], _sharpened(image, pixels, clear))

    def size_in(self, image: Image) -> tuple[int, int] | None:
        """See `Board`: the markers mean nothing without the right dictionary."""
        return None

    def like(self, corners: Corners, reference: Corners) -> Corners:
        """See `Board`: markers leave nothing open."""
        return corners

    def _markers(self) -> "cv2.aruco.Dictionary":
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))


def _grid(board: Board) -> Array:
    """Return the (columns * rows, 3) corners on the board [m], row by row."""
    x, y = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    return np.asarray(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1) * board.square_m, np.float64)


def _sharpened(image: Image, pixels: NDArray[np.float32], clear: float) -> Array:
    """Return corners (N, 2) refined to where the edges meet: detectors are off by up to a pixel at the board's rim.

    Args:
        image: (H, W).
        pixels: (N, 1, 2) corners found.
        clear: share of the distance between corners around each, each way, in which there is no other edge.
    """
    spacing = float(pdist(pixels.reshape(-1, 2)).min())
    reach = int(np.clip(clear * spacing - BLURRED, LEAST_REACH, LARGEST_REACH))
    refined = cv2.cornerSubPix(image, pixels.copy(), (reach, reach), (-1, -1), SUBPIXEL_CRITERIA)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def _check(columns: int, rows: int, square_m: float) -> None:
    if min(columns, rows) < SMALLEST:
        raise CalibrationError(
            f"board {columns}x{rows} is too small; count its inner corners, {SMALLEST} or more each way"
        )
    if not square_m > 0:
        raise CalibrationError(f"square of {square_m} m must be positive; measure the side of one square")
