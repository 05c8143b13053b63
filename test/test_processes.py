# SPDX-License-Identifier: Apache-2.0
"""Workers exit with their parent process, whatever terminates it; processor time is read as it is counted."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import as_completed
from pathlib import Path

import pytest

from uav_vslam.errors import WorkerEnded
from uav_vslam.processes import processor_time_s, worker_pool
from waiting import wait_for

PROGRAM = """
import os, signal, time
from uav_vslam.processes import worker_pool

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs inherit SIGINT ignored
    with worker_pool(2) as pool:
        first, work = pool.submit(os.getpid), pool.submit(time.sleep, 3600.0)
        print(first.result(), flush=True)
        work.result()
"""


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_workers_exit_with_their_parent(number: signal.Signals, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    with subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as main:
        assert main.stdout is not None
        worker = int(main.stdout.readline())
        main.send_signal(number)
        assert main.wait() != 0
        assert wait_for(lambda: gone(worker))


def test_an_error_in_the_block_terminates_the_workers_at_once() -> None:
    def work() -> None:
        with worker_pool(2) as pool:
            for done in as_completed([pool.submit(time.sleep, 3600.0), pool.submit(divmod, 1, 0)]):
                done.result()

    with pytest.raises(ZeroDivisionError):
        work()  # returns, though a worker would sleep for an hour


def test_each_worker_calls_the_initializer_first(capfd: pytest.CaptureFixture[str]) -> None:
    with worker_pool(1, print, "begun") as pool:
        assert pool.submit(len, "four").result() == 4
    assert capfd.readouterr().out.strip() == "begun"


def test_a_worker_that_the_system_ends_is_told() -> None:
    with pytest.raises(WorkerEnded, match="memory is short: use --workers 1"), worker_pool(1) as pool:
        pool.submit(os.kill, pool.submit(os.getpid).result(), signal.SIGKILL).result()


def test_the_processor_time_of_a_process_is_that_of_the_clock() -> None:
    before_s, clock_s = processor_time_s(os.getpid()), time.process_time()
    while time.process_time() - clock_s < 0.2:
        pass
    taken_s = time.process_time() - clock_s
    assert processor_time_s(os.getpid()) - before_s == pytest.approx(taken_s, abs=0.05)  # the kernel counts in 10 ms


def test_a_process_that_has_ended_has_no_processor_time() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    with pytest.raises(OSError, match=str(process.pid)):
        processor_time_s(process.pid)
