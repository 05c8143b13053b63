# SPDX-License-Identifier: Apache-2.0
"""All errors that the library raises, in one hierarchy.

The command line prints a `UavVslamError` as one line and exits with 2; a node logs it, drops the message that
caused it and counts the drop.
"""


class UavVslamError(Exception):
    """Base of all deliberate errors; the text gives the value met, the values allowed and the remedy."""


def one_line(error: Exception) -> str:
    """Return the text of another library's error, which may have several lines, in one; its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


class ConfigError(UavVslamError):
    """A configuration key, type or value is wrong."""


class InvalidYaml(UavVslamError, ValueError):
    """A text is no YAML; what it is of is told by whoever reads it."""


class BagError(UavVslamError):
    """A recording is missing, damaged or incomplete."""


class CalibrationError(UavVslamError):
    """A camera or rig calibration is missing or inconsistent."""


class TrajectoryFileError(UavVslamError):
    """A trajectory file is missing, malformed, or does not belong to its ground truth."""


class PictureError(UavVslamError):
    """A picture or the table of positions beside it can't be used, or the pictures do not determine a mosaic."""


class WorkerEnded(UavVslamError):
    """A process that shared the work was ended by the system: no fault of the input, so the command exits with 1."""


class MapError(UavVslamError):
    """A saved map is missing, damaged or does not suit the flight."""


class InvalidMessage(UavVslamError, ValueError):
    """A received message or reading can't be used; `reason` is a short key under which the drop is counted."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason


class FilterDivergence(UavVslamError):
    """An estimate lost its positive definiteness; the text names the time, the block and the smallest eigenvalue."""
