# SPDX-License-Identifier: Apache-2.0
"""What the command says beside its results, on standard error."""

import sys
from collections.abc import Iterable


def warn(text: str) -> None:
    """Print a warning."""
    print(f"uav-vslam: warning: {text}", file=sys.stderr)


def warn_each(texts: Iterable[str]) -> None:
    """Print warnings, each once: vehicles may share a bag and a configuration."""
    for text in dict.fromkeys(texts):
        warn(text)
