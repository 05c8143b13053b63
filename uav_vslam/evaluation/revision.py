# SPDX-License-Identifier: Apache-2.0
"""The code revision of a result."""

import subprocess
from pathlib import Path


def git_revision(folder: Path | None = None) -> str | None:
    """Return the short revision of a source tree, "-dirty" if tracked files differ from it; None outside git.

    Args:
        folder: inside the tree; the one of this package if None.
    """
    command = ["git", "--no-optional-locks", "describe", "--always", "--dirty", "--exclude=*"]
    where = folder or Path(__file__).resolve().parent
    try:
        done = subprocess.run(command, cwd=where, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None
