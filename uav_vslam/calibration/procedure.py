# SPDX-License-Identifier: Apache-2.0
"""The whole calibration: boards found, outliers rejected, both halves of the pictures compared."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uav_vslam.calibration.boards import Board
from uav_vslam.calibration.bundle import BoardPair
from uav_vslam.calibration.solve import Lens, StereoSolution, first_rig, reproject, rms, solve
from uav_vslam.errors import CalibrationError, UavVslamError
from uav_vslam.geometry.camera import PinholeCamera
from uav_vslam.geometry.stereo import SIDES, StereoRig

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Picture = Image | UavVslamError  # 8-bit grey, or why it can't be read

LEAST_PAIRS = 8  # so that each half has four: a plane needs three views, and one more shows an error
OUTLIER = 3.0  # times the median reprojection error of the pairs; noise alone scatters it by a few per cent
DISAGREEMENT = 0.01  # of baselines or focal lengths, between halves or as a standard deviation, that earns a warning
MOST_ROUNDS = 10  # of solving and telling which pairs agree
LOOKED_AT, LEAST_ALIKE = 8, 4  # pictures with a board whose size is looked at, and how many must agree on another one
CELLS = 8  # of an image each way, for coverage


@dataclass(frozen=True, slots=True)
class Rejected:
    """A pair that was not used, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Boards:
    """What was found in all pictures.

    Attributes:
        pairs: boards seen by both cameras.
        rejected: pairs without.
        size: width and height of all images [px].
    """

    pairs: list[BoardPair]
    rejected: list[Rejected]
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class HalfCheck:
    """A calibration solved again from every second pair, and from the others.

    Attributes:
        halves: both solutions.
        own_px: reprojection error of each half with its own rig.
        other_px: reprojection error of each half with the rig of the other one.
    """

    halves: tuple[StereoSolution, StereoSolution]
    own_px: tuple[float, float]
    other_px: tuple[float, float]

    @property
    def baseline_difference(self) -> float:
        """Of the halves, relative."""
        return _difference(*(half.rig.baseline_m for half in self.halves))

    @property
    def focal_difference(self) -> float:
        """Of the halves, relative: the larger one of the two cameras."""
        left, right = ([getattr(half.rig, side).fx for half in self.halves] for side in SIDES)
        return max(_difference(*left), _difference(*right))


@dataclass(frozen=True, slots=True)
class StereoCalibration:
    """The result.

    Attributes:
        solution: cameras, their standard deviations, residuals.
        lens: how lenses were modelled.
        pairs: that were used, in the order of the residuals.
        rejected: pairs that were not.
        check: from halves.
        warnings: what is doubtful, in words.
    """

    solution: StereoSolution
    lens: Lens
    pairs: list[BoardPair]
    rejected: list[Rejected]
    check: HalfCheck
    warnings: list[str]


def find_boards(
    pictures: Iterable[tuple[str, Picture, Picture]], board: Board, *, on_pair: Callable[[], object] = lambda: None
) -> Boards:
    """Find the board in all pictures.

    Args:
        pictures: name, left and right image of each pair; pairs of which one can't be read, or is of another size
            than the first one, are rejected.
        board: to look for.
        on_pair: called after each pair.

    Raises:
        CalibrationError: both pictures of a pair are the same, too few show the board, or it is a part of theirs.
    """
    pairs: list[BoardPair] = []
    rejected: list[Rejected] = []
    useless: list[str] = []
    sizes_seen: dict[bool, list[tuple[int, int]]] = {True: [], False: []}  # of boards, where it was found and was not
    size: tuple[int, int] | None = None
    for name, *both in pictures:
        images = [image for image in both if not isinstance(image, UavVslamError)]
        size = size or next((image.shape[::-1] for image in images), None)
        reasons = [str(image) for image in both if isinstance(image, UavVslamError)] or _other_sizes(name, images, size)
        if reasons:
            useless.append("; ".join(dict.fromkeys(reasons)))
            rejected.append(Rejected(name, useless[-1]))
            on_pair()
            continue
        left, right = (board.detect(image) for image in images)
        if left is None or right is None:
            sizes_seen[False] += [found for found in map(board.size_in, images) if found is not None]
            rejected.append(Rejected(name, f"no board found in {_where(left is None, right is None)}"))
        elif np.array_equal(images[0], images[1]):
            raise CalibrationError(f"both pictures of pair {name} are the same; name each camera's own")
        elif not (left.fix_pose and right.fix_pose):
            where = _where(not left.fix_pose, not right.fix_pose)
            rejected.append(Rejected(name, f"the corners found in {where} lie in one line: no pose follows"))
        else:
            pairs.append(BoardPair(name, left, board.like(right, left)))
            if len(pairs) <= LOOKED_AT and (found := board.size_in(images[0])) is not None:
                sizes_seen[True].append(found)
        on_pair()
    other = _other_board(board, sizes_seen[bool(pairs)], larger=bool(pairs))
    if other and pairs:  # the detector takes a part of a board for one
        raise CalibrationError(
            f"a board of {board.columns}x{board.rows} inner corners is a part of the one seen; {other}"
        )
    if size is None or len(pairs) < LEAST_PAIRS:
        raise CalibrationError(_too_few(pairs, rejected, useless, other or board.ADVICE, board))
    return Boards(pairs, rejected, size)


def _where(in_left: bool, in_right: bool) -> str:
    return "both images" if in_left and in_right else "the left image" if in_left else "the right image"


def calibrate(boards: Boards, lens: Lens) -> StereoCalibration:
    """Calibrate, reject outliers, and calibrate halves.

    Raises:
        CalibrationError: too few pairs agree.
    """
    solution, errors, agrees = _trimmed(boards.pairs, boards.size, lens)
    pairs = [pair for pair, good in zip(boards.pairs, agrees, strict=True) if good]
    usual = float(np.median(errors[agrees]))
    rejected = boards.rejected + [
        Rejected(pair.name, f"outlier: {error:.2f} px, {error / usual:.1f} times the median")
        for pair, error, good in zip(boards.pairs, errors, agrees, strict=True)
        if not good
    ]
    check = _half_check(pairs, boards.size, lens)
    found = StereoCalibration(solution, lens, pairs, rejected, check, [])
    return replace(found, warnings=_warnings(found))


def _trimmed(
    pairs: Sequence[BoardPair], size: tuple[int, int], lens: Lens
) -> tuple[StereoSolution, Array, NDArray[np.bool_]]:
    """Solve from the pairs that agree with the solution.

    An outlier pulls the solution of all pairs so far that the others look no better: the first rig, which it does not
    pull, determines the pairs to begin with.

    Returns:
        The solution, the reprojection error of each pair with it [px], and which pairs it is of.
    """
    errors = _errors(first_rig(pairs, size, lens), pairs)
    agrees = errors <= OUTLIER * np.median(errors)
    for _ in range(MOST_ROUNDS):
        if agrees.sum() < LEAST_PAIRS:
            raise CalibrationError(
                f"only {agrees.sum()} pairs agree, {LEAST_PAIRS} are needed; is the rig rigid, the board flat, and "
                "are both images of a pair taken at the same moment?"
            )
        solution = solve([pair for pair, good in zip(pairs, agrees, strict=True) if good], size, lens)
        errors = _errors(solution.rig, pairs)
        before, agrees = agrees, errors <= OUTLIER * np.median(errors[agrees])
        if np.array_equal(before, agrees):
            break
    return solution, errors, before


def _errors(rig: StereoRig, pairs: Sequence[BoardPair]) -> Array:
    return np.array([rms(residuals) for residuals in reproject(rig, pairs)])


def coverage(found: StereoCalibration, side: str) -> float:
    """Return the share of an image's cells, `CELLS` each way, that hold a corner."""
    camera = getattr(found.solution.rig, side)
    pixels = np.concatenate([getattr(pair, side).pixels for pair in found.pairs])
    return len(np.unique(cells(pixels, camera), axis=0)) / CELLS**2


def cells(pixels: Array, camera: PinholeCamera) -> NDArray[np.intp]:
    """Return column and row of the image's cell of (N, 2) pixels."""
    return np.clip(np.floor(pixels / camera.size * CELLS), 0, CELLS - 1).astype(np.intp)


def _half_check(pairs: Sequence[BoardPair], size: tuple[int, int], lens: Lens) -> HalfCheck:
    odd, even = pairs[::2], pairs[1::2]
    halves = solve(odd, size, lens), solve(even, size, lens)
    first, second = (half.rig for half in halves)
    return HalfCheck(
        halves,
        (_rms_of(halves[0].residuals), _rms_of(halves[1].residuals)),
        (_rms_of(reproject(second, odd)), _rms_of(reproject(first, even))),
    )


def _warnings(found: StereoCalibration) -> list[str]:
    check, warnings = found.check, []
    solution = found.solution
    for what, sigma, value in (
        ("baseline", solution.sigma_baseline_m, solution.rig.baseline_m),
        ("left focal length", solution.sigma_left[0], solution.rig.left.fx),
        ("right focal length", solution.sigma_right[0], solution.rig.right.fx),
    ):
        if sigma > DISAGREEMENT * value:
            warnings.append(
                f"the pictures leave the {what} uncertain by {100 * sigma / value:.1f} % (standard deviation); "
                "take more, with the board tilted different ways"
            )
    for what, difference in (("baseline", check.baseline_difference), ("focal length", check.focal_difference)):
        if difference > DISAGREEMENT:
            warnings.append(
                f"the {what} from odd and from even pairs differs by {100 * difference:.1f} %; take more pictures, "
                "with the board tilted different ways and near all edges of both images"
            )
    return warnings


def _rms_of(residuals: Iterable[tuple[Array, Array]]) -> float:
    return rms([part for pair in residuals for part in pair])


def _difference(first: float, second: float) -> float:
    return abs(first - second) / (0.5 * (first + second))


def _other_sizes(name: str, images: Sequence[Image], size: tuple[int, int] | None) -> list[str]:
    """Return which pictures of a pair are of another size than the first one, in words."""
    return [
        f"the {side} picture of pair {name} is {image.shape[1]}x{image.shape[0]} px but the first picture "
        f"{size[0]}x{size[1]}"
        for side, image in zip(SIDES, images, strict=False)
        if size and image.shape[::-1] != size
    ]


def _too_few(
    pairs: Sequence[BoardPair],
    rejected: Sequence[Rejected],
    useless: Sequence[str],
    advice: str,
    board: Board,
) -> str:
    count = len(pairs) + len(rejected)
    size = max(board.columns, board.rows), min(board.columns, board.rows)
    text = f"{len(pairs)} of {count} pairs show the {size[0]}x{size[1]} board in both images; {LEAST_PAIRS} are needed"
    if useless:
        text = f"{text}; {len(useless)} can't be used, the first: {useless[0]}"
    if len(rejected) == len(useless):
        return f"{text}; take more pictures"
    return f"{text}; {advice}"


def _other_board(board: Board, seen: Sequence[tuple[int, int]], *, larger: bool) -> str:
    """Return which other board most images show, in words; empty if they do not.

    Args:
        board: that was looked for.
        seen: inner corners of the boards in some images, the longer side first.
        larger: only a board of which that one is a part.
    """
    size = max(board.columns, board.rows), min(board.columns, board.rows)
    columns, rows = likely = max(set(seen), key=seen.count, default=size)
    count = seen.count(likely)
    if likely == size or 2 * count <= len(seen) or count < LEAST_ALIKE:  # a few may be mistaken
        return ""
    if larger and (columns < size[0] or rows < size[1]):
        return ""
    return f"{count} images show a board of {columns}x{rows} inner corners: use --board {columns}x{rows}"
