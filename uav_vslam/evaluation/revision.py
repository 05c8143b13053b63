# SPDX-License-Identifier: Apache-2.0
"""The code revision of a result."""

import subprocess
from pathlib import Path


def git_revision(folder: Path | None = None) -> str | None:
    """Return the short revision of a source tree, "-dirty" if tracked files differ from it; None outside git.

    Args:
        folder: inside the tree; the one of this package if None.
    """
    where = folder or Path(__file__).resolve().parent
    try:
        revision = _git(where, "rev-parse", "--short", "HEAD")
        # `describe --dirty` would rewrite the index, and leave it locked on a full disk.
        changes = _git(where, "--no-optional-locks", "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{revision}-dirty" if changes else revision


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()
