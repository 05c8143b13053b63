# SPDX-License-Identifier: Apache-2.0
"""Freed memory is kept for the next array instead of being returned to the kernel."""

import ctypes
import sys

KEPT_BYTES = 64 << 20  # free memory that a process keeps
LARGEST_BYTES = 32 << 20  # larger arrays are mapped one by one, and unmapped when freed; glibc allows no more
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h


def keep_freed_memory() -> None:
    """Let malloc keep freed memory; glibc only.

    The matrices and images of a frame are megabytes each, and are freed before the next frame. Returned to the kernel,
    each page comes back by a page fault: a quarter of the estimator's time at 200 landmarks in view.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, LARGEST_BYTES)
        mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
