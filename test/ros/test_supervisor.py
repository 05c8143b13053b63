# SPDX-License-Identifier: Apache-2.0
"""A fleet's processes shut down together and in time, for any cause; tested with real processes, without ROS."""

import dataclasses
import itertools
import os
import pty
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.ros import supervisor
from uav_vslam.ros.command import Command
from uav_vslam.ros.supervisor import ESCALATION, Supervisor, describe_exit
from waiting import PATIENCE_S, wait_for

pytestmark = pytest.mark.ros

POLITE = "import time; print('ready'); time.sleep(3600)"  # ends at SIGINT
DEAF = """
    import os, signal, time
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: print("ignored", signal.Signals(number).name))
    print("ready")
    while True:
        time.sleep(3600)
"""
FIRST_ONLY = ESCALATION[:1]  # a process that ignores the first signal hangs
HASTY = tuple((0.5 * k, number) for k, (_, number) in enumerate(ESCALATION))
Escalation = tuple[tuple[float, signal.Signals], ...]


def python(name: str, code: str, *, leads: bool = False) -> Command:
    return Command(name, [sys.executable, "-c", textwrap.dedent(code)], leads)


def write_pid(folder: Path, name: str, code: str, *, leads: bool) -> Command:
    """A process that first writes its process id."""
    begin = f"import os, pathlib\npathlib.Path({str(folder / name)!r}).write_text(str(os.getpid()))\n"
    return python(name, begin + textwrap.dedent(code), leads=leads)


def leader(condition: str, then: str = "") -> Command:
    """The leading process: it ends when a condition on `Path` holds, however long a busy machine takes to bring it."""
    code = f"""
        import time
        from pathlib import Path
        end_s = time.monotonic() + {PATIENCE_S}
        while not ({condition}) and time.monotonic() < end_s:
            time.sleep(0.02)
        {then}
    """
    return python("a", code, leads=True)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@contextmanager
def supervised(
    folder: Path, codes: dict[str, str], escalation: Escalation, *, leader: str = ""
) -> Iterator[tuple[subprocess.Popen[str], list[int]]]:
    """Start a supervisor in its own process; wait until all of its processes run."""
    commands = [write_pid(folder, name, code, leads=name == leader) for name, code in codes.items()]
    program = (
        "import sys\n"
        "from uav_vslam.ros.command import Command\n"
        "from uav_vslam.ros.supervisor import Supervisor\n"
        f"sys.exit(Supervisor(escalation={[(s, int(number)) for s, number in escalation]!r}).run({commands!r}))"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert wait_for(lambda: all((folder / name).exists() and (folder / name).read_text() for name in codes))
            assert process.stdout is not None
            for _ in codes:
                assert "ready" in process.stdout.readline()
            yield process, [int((folder / name).read_text()) for name in codes]
        finally:
            process.kill()


RESUMED = """
    import sys, time
    print("started with", *sys.argv[1:], flush=True)
    time.sleep(60.0) if "again" in sys.argv else sys.exit({code})
"""


@pytest.mark.parametrize("ended", [5, 0])  # SIGTERM from outside makes a node end with 0
def test_a_process_that_ends_is_restarted_to_resume_and_the_others_go_on(ended: int, tmp_path: Path) -> None:
    failing, resumed = dataclasses.replace(python("b", RESUMED.format(code=ended)), resume=("again",)), tmp_path / "b"
    leading = leader(f"Path({str(resumed)!r}).exists()", "print('still here', flush=True)")
    lines: list[tuple[str, str]] = []

    def note(name: str, line: str) -> None:
        lines.append((name, line))
        if "again" in line:
            resumed.touch()

    code = Supervisor(restarts=True, on_line=note).run([failing, leading])
    assert lines == [("b", "started with"), ("b", "started with again"), ("a", "still here")]
    assert code == 0


def test_a_process_that_would_fail_again_is_not_restarted() -> None:
    lines: list[str] = []
    wrong = python("b", RESUMED.format(code=2))
    assert Supervisor(restarts=True, on_line=lambda _, line: lines.append(line)).run([wrong]) == 2
    assert lines == ["started with"]


def test_a_process_that_has_run_for_long_is_restarted_whatever_it_refuses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(supervisor, "STABLE_S", 0.0)
    failing, resumed = dataclasses.replace(python("b", RESUMED.format(code=2)), resume=("again",)), tmp_path / "b"

    def note(_: str, line: str) -> None:
        if "again" in line:
            resumed.touch()

    leading = leader(f"Path({str(resumed)!r}).exists()")
    assert Supervisor(restarts=True, on_line=note).run([failing, leading]) == 0


def test_a_process_that_has_run_before_is_restarted_whatever_it_refuses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(supervisor, "BACKOFF_S", (0.05,))
    program = "import sys; print(*sys.argv[1:], flush=True); sys.exit(2 if 'again' in sys.argv else 5)"
    failing, often = dataclasses.replace(python("b", program), resume=("again",)), tmp_path / "often"
    lines: list[str] = []

    def note(_: str, line: str) -> None:
        lines.append(line)
        if len(lines) >= 4:
            often.touch()

    patient = Supervisor(restarts=True, on_line=note, escalation=((PATIENCE_S, signal.SIGKILL),))
    code = patient.run([failing, leader(f"Path({str(often)!r}).exists()")])
    assert code == 2  # as it ended last, when the leading process was done
    assert lines[:4] == ["", "again", "again", "again"]


def test_pauses_between_restarts_grow(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(supervisor, "BACKOFF_S", (0.05, 0.3, 0.6))
    stamps: list[float] = []
    failing, often = python("b", "import time; print(time.monotonic(), flush=True); exit(5)"), tmp_path / "often"

    def note(_: str, line: str) -> None:
        stamps.append(float(line))
        if len(stamps) >= 4:
            often.touch()

    Supervisor(restarts=True, on_line=note).run([failing, leader(f"Path({str(often)!r}).exists()")])
    pauses = [later - earlier for earlier, later in itertools.pairwise(stamps)]
    assert len(pauses) >= 3
    assert pauses[1] > 0.3
    assert min(pauses[2:]) > 0.6


@pytest.mark.usefixtures("hangup")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_shuts_down_all(tmp_path: Path, number: signal.Signals) -> None:
    with supervised(tmp_path, {"a": POLITE, "b": POLITE}, FIRST_ONLY) as (process, pids):
        process.send_signal(number)
        assert process.wait() == 0
        assert not any(map(alive, pids))


def test_a_fleet_under_nohup_outlives_its_terminal(tmp_path: Path) -> None:
    """What is started inherits that a signal is ignored."""
    done = tmp_path / "done"
    waits = f"""
        import pathlib, time
        print("ready")
        while not pathlib.Path({str(done)!r}).exists():
            time.sleep(0.02)
    """
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with supervised(tmp_path, {"a": POLITE, "replay": waits}, FIRST_ONLY, leader="replay") as (process, _):
            process.send_signal(signal.SIGHUP)
            done.touch()
            assert process.wait() == 0  # of the replay, not of an interrupted one
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_fleet_goes_on_when_its_terminal_is_gone(tmp_path: Path) -> None:
    """As one that was started in the background, and disowned."""
    gone, done = tmp_path / "gone", tmp_path / "done"
    talking = f"""
        import time
        from pathlib import Path
        while not Path({str(gone)!r}).exists():
            time.sleep(0.02)
        print("into the void", flush=True)
        time.sleep(3600)
    """
    commands = [python("talker", talking), leader(f"Path({str(done)!r}).exists()")]
    program = f"""
        from uav_vslam.ros.command import Command
        from uav_vslam.ros.supervisor import Supervisor, print_line

        def note(name, line):
            print_line(name, line)
            open({str(done)!r}, "w").close()

        raise SystemExit(Supervisor(on_line=note).run({commands!r}))
    """
    terminal, end = pty.openpty()
    command = [sys.executable, "-c", textwrap.dedent(program)]
    with subprocess.Popen(command, stdout=end, stderr=subprocess.PIPE, start_new_session=True) as process:
        os.close(end)
        os.close(terminal)
        gone.touch()
        assert b"Traceback" not in process.communicate()[1]
        assert done.exists()


def test_a_signal_that_interrupts_the_leader_is_the_exit_code(tmp_path: Path) -> None:
    with supervised(tmp_path, {"a": POLITE, "replay": POLITE}, FIRST_ONLY, leader="replay") as (process, pids):
        process.send_signal(signal.SIGINT)
        assert process.wait() == 128 + signal.SIGINT
        assert not any(map(alive, pids))


def test_a_log_that_can_not_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="no log can be kept there"):
        Supervisor(log_dir=tmp_path / "file" / "log").run([python("talker", "print()", leads=True)])


def test_a_process_that_ignores_signals_is_killed(tmp_path: Path) -> None:
    with supervised(tmp_path, {"deaf": DEAF, "polite": POLITE}, HASTY) as (process, pids):
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate()
        said = [line for line in output.splitlines() if "ignored" in line or "killed" in line]
        expected = ["[deaf] ignored SIGINT", "[deaf] ignored SIGTERM", "uav-vslam: deaf does not exit; it is killed"]
        assert sorted(said) == sorted([*expected, "uav-vslam: deaf was killed by SIGKILL during shutdown"])
        assert process.returncode == 128 + signal.SIGKILL
        assert not any(map(alive, pids))


def test_shutdown_takes_less_than_five_seconds() -> None:
    assert ESCALATION[-1][0] < 5.0
    assert ESCALATION[-1][1] == signal.SIGKILL


def test_no_orphan_is_left_when_the_supervisor_is_killed(tmp_path: Path) -> None:
    with supervised(tmp_path, {"deaf": DEAF, "polite": POLITE}, ESCALATION) as (process, pids):
        assert all(map(alive, pids))
        process.kill()
        process.wait()
        assert wait_for(lambda: not any(map(alive, pids)))


def test_the_leader_s_exit_shuts_down_all_and_is_no_failure(capfd: pytest.CaptureFixture[str]) -> None:
    supervisor = Supervisor(escalation=FIRST_ONLY)
    assert supervisor.run([python("worker", POLITE), python("replay", "print('done')", leads=True)]) == 0
    output = capfd.readouterr()
    assert "[replay] done" in output.out
    assert output.err == ""


def test_processes_that_could_not_leave_their_ros_domain_after_all_else_have_not_failed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    ready = tmp_path / "ready"
    kept = "import os; os.kill(os.getpid(), signal.SIGALRM)"
    worker = f"""
        import pathlib, signal, time
        def stop(*_):
            {kept}
        signal.signal(signal.SIGINT, stop)
        signal.signal(signal.SIGTERM, stop)
        pathlib.Path({str(ready)!r}).touch()
        time.sleep(3600)
    """
    lead = leader(f"Path({str(ready)!r}).exists()", f"import signal; {kept}")
    assert Supervisor().run([python("worker", worker), lead]) == 0
    assert capfd.readouterr().err == ""


def test_the_leader_s_failure_is_the_exit_code(capfd: pytest.CaptureFixture[str]) -> None:
    assert Supervisor().run([python("worker", POLITE), python("replay", "exit(3)", leads=True)]) == 3
    assert "replay ended with exit code 3" in capfd.readouterr().err


@pytest.mark.parametrize(("code", "expected"), [("exit(7)", 7), ("pass", 1), ("import os; os.abort()", 134)])
def test_a_process_that_dies_shuts_down_the_fleet_and_is_reported(
    code: str, expected: int, capfd: pytest.CaptureFixture[str]
) -> None:
    replay = python("replay", POLITE, leads=True)
    assert Supervisor().run([python("uav1/fusion", code), python("worker", POLITE), replay]) == expected
    assert "uav1/fusion" in capfd.readouterr().err


def test_failing_during_shutdown_is_a_failure(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    ready = tmp_path / "ready"
    stubborn = f"""
        import pathlib, signal, sys, time
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: sys.exit(4))
        pathlib.Path({str(ready)!r}).touch()
        time.sleep(3600)
    """
    assert Supervisor().run([python("recorder", stubborn), leader(f"Path({str(ready)!r}).exists()")]) == 4
    assert "recorder ended with exit code 4 during shutdown" in capfd.readouterr().err


def test_a_program_that_is_still_starting_exits_without_a_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    assert Supervisor().run([python("starting", POLITE), python("replay", "print(1)", leads=True)]) == 0
    assert "Traceback" not in capfd.readouterr().out


def test_output_is_prefixed_line_by_line_and_kept_in_files(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    code = "import sys; sys.stdout.write('one\\ntwo\\nlast'); sys.stdout.flush(); sys.stderr.write('\\n'); "
    Supervisor(log_dir=tmp_path / "logs").run([python("uav1/slam_backend", code, leads=True)])
    assert capfd.readouterr().out.splitlines() == [f"[uav1/slam_backend] {line}" for line in ("one", "two", "last")]
    assert (tmp_path / "logs" / "uav1_slam_backend.log").read_text() == "one\ntwo\nlast\n"


def test_the_environment_is_inherited() -> None:
    lines: list[tuple[str, str]] = []
    supervisor = Supervisor({"ROS_DOMAIN_ID": "42"}, on_line=lambda name, line: lines.append((name, line)))
    supervisor.run([python("a", "import os; print(os.environ['ROS_DOMAIN_ID'])", leads=True)])
    assert lines == [("a", "42")]


def test_a_missing_program_shuts_down_those_already_started(tmp_path: Path) -> None:
    worker = write_pid(tmp_path, "worker", POLITE, leads=False)
    with pytest.raises(ConfigError, match="ghost can't be started"):
        Supervisor().run([worker, Command("ghost", [str(tmp_path / "nothing")])])
    if (tmp_path / "worker").exists():
        assert not alive(int((tmp_path / "worker").read_text()))


def test_signal_handlers_are_restored() -> None:
    before = signal.getsignal(signal.SIGTERM)
    Supervisor().run([python("a", "pass", leads=True)])
    assert signal.getsignal(signal.SIGTERM) is before


def test_exits_are_described() -> None:
    assert describe_exit(3) == "ended with exit code 3"
    assert describe_exit(-signal.SIGSEGV) == "was killed by SIGSEGV"


OPTIONAL_FAILS = """
    import os, signal
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("restarts", [False, True])
def test_a_fleet_goes_on_and_ends_well_without_an_optional_process_that_dies(
    restarts: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recorder = dataclasses.replace(write_pid(tmp_path, "recorder", OPTIONAL_FAILS, leads=False), optional=True)
    pid = f"Path({str(tmp_path / 'recorder')!r})"
    noticed = f"{pid}.exists() and {pid}.read_text() and not Path('/proc', {pid}.read_text()).exists()"
    assert Supervisor(restarts=restarts).run([recorder, python("node", POLITE), leader(noticed)]) == 0
    told = capfd.readouterr().err
    assert told.count("recorder was killed by SIGKILL; the fleet goes on without it") == 1


def test_an_optional_process_whose_input_is_wrong_ends_the_fleet() -> None:
    recorder = dataclasses.replace(python("recorder", "raise SystemExit(2)"), optional=True)
    assert Supervisor().run([recorder, python("node", POLITE)]) == 2


def test_a_full_disk_under_the_log_files_ends_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "replay.log").symlink_to("/dev/full")
    replay = python("replay", "print('line\\n' * 9000)", leads=True)
    assert Supervisor(log_dir=tmp_path, on_line=lambda *_: None).run([replay]) == 0
    assert capfd.readouterr().err.count("the log file of replay ends here: No space left on device") == 1
