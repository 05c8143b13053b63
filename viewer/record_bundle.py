# SPDX-License-Identifier: Apache-2.0
"""Records what the bundle of the report page was made of: SHA-256 of sources, lock and result."""

import hashlib
import json
from pathlib import Path

VIEWER = Path(__file__).parent
ASSETS = VIEWER.parent / "uav_vslam" / "report" / "page" / "assets"
RECORD = ASSETS / "viewer.json"


def record() -> dict[str, str]:
    """Return the hashes of sources and bundle as they are now."""
    sources = [*sorted((VIEWER / "src").glob("*.js")), VIEWER / "package.json", VIEWER / "package-lock.json"]
    return {
        "sources": _hash(sources),
        "bundle": _hash([ASSETS / "viewer.js", ASSETS / "viewer.licenses.txt"]),
    }


def _hash(paths: list[Path]) -> str:
    """Return the hash of names and contents."""
    found = hashlib.sha256()
    for path in paths:
        found.update(f"{path.name}\0{path.stat().st_size}\0".encode())
        found.update(path.read_bytes())
    return found.hexdigest()


if __name__ == "__main__":
    RECORD.write_text(json.dumps(record(), indent=2) + "\n", encoding="utf-8")
