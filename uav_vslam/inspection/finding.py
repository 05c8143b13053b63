# SPDX-License-Identifier: Apache-2.0
"""What a check found."""

import enum
from collections.abc import Iterable
from dataclasses import dataclass


class Severity(enum.Enum):
    """How much a finding matters."""

    ERROR = "error"  # the graph can't run, or its result is certainly wrong, or most of it without images
    WARNING = "warning"  # it runs, with less accuracy, or on a part of the data
    OK = "ok"


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one check.

    Attributes:
        severity: how much it matters.
        subject: what was checked, for example "IMU gravity".
        seen: values met.
        allowed: values allowed; empty for `OK`.
        remedy: what to do; empty for `OK`.
    """

    severity: Severity
    subject: str
    seen: str
    allowed: str = ""
    remedy: str = ""


def error(subject: str, seen: str, allowed: str, remedy: str) -> Finding:
    """Return an error."""
    return Finding(Severity.ERROR, subject, seen, allowed, remedy)


def warning(subject: str, seen: str, allowed: str, remedy: str) -> Finding:
    """Return a warning."""
    return Finding(Severity.WARNING, subject, seen, allowed, remedy)


def ok(subject: str, seen: str) -> Finding:
    """Return the outcome of a check that found no fault."""
    return Finding(Severity.OK, subject, seen)


def count(findings: Iterable[Finding], severity: Severity) -> int:
    """Return how many findings are of a severity."""
    return sum(finding.severity is severity for finding in findings)
