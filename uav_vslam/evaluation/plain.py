# SPDX-License-Identifier: Apache-2.0
"""Figures as JSON can hold them."""

import math
from typing import Any


def plain(value: Any) -> Any:
    """Return numpy scalars as Python numbers, and None for NaN and infinity, recursively."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
