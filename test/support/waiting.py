# SPDX-License-Identifier: Apache-2.0
"""Waits for what other threads and processes bring about, without a limit that a busy machine breaks."""

import time
from collections.abc import Callable
from typing import Any

TURNS, TURN_S = 3000, 0.02
PATIENCE_S = 60.0


def wait_for(
    condition: Callable[[], Any],
    turn: Callable[[], Any] = lambda: time.sleep(TURN_S),
    *,
    alive: Callable[[], bool] | None = None,
) -> bool:
    """Take turns until the condition holds; return whether it does.

    Without `alive`, it gives up after so many turns and so many seconds, whichever comes last: a busy machine delays
    our turns as it delays the work of the others. With it, only when it no longer holds: a node graph takes half a
    minute of processor time to start. What hangs for good is left to pytest's `timeout`.
    """
    turns, end_s = 0, time.monotonic() + PATIENCE_S
    while not (holds := bool(condition())):
        patient = alive() if alive else turns < TURNS or time.monotonic() < end_s
        if not patient:
            break
        turn()
        turns += 1
    return holds
