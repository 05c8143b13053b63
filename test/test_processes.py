# SPDX-License-Identifier: Apache-2.0
"""Workers exit with their parent process, whatever terminates it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import as_completed
from pathlib import Path

import pytest

from uav_vslam.processes import worker_pool

PATIENCE_S = 20.0
PROGRAM = """
import os, signal, time
from uav_vslam.processes import worker_pool

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs inherit SIGINT ignored
    with worker_pool(2) as pool:
        first, work = pool.submit(os.getpid), pool.submit(time.sleep, 60.0)
        print(first.result(), flush=True)
        work.result()
"""


def gone(pid: int) -> bool:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_workers_exit_with_their_parent(number: signal.Signals, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    with subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as main:
        assert main.stdout is not None
        worker = int(main.stdout.readline())
        main.send_signal(number)
        assert main.wait(PATIENCE_S) != 0
        assert gone(worker)


def test_an_error_in_the_block_terminates_the_workers_at_once() -> None:
    def work() -> None:
        with worker_pool(2) as pool:
            for done in as_completed([pool.submit(time.sleep, 60.0), pool.submit(divmod, 1, 0)]):
                done.result()

    begin_s = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        work()
    assert time.monotonic() - begin_s < PATIENCE_S


def test_each_worker_calls_the_initializer_first(capfd: pytest.CaptureFixture[str]) -> None:
    with worker_pool(1, print, "begun") as pool:
        assert pool.submit(len, "four").result() == 4
    assert capfd.readouterr().out.strip() == "begun"
