# SPDX-License-Identifier: Apache-2.0
"""A claimed ROS domain is exclusive while it is held; tested with real sockets and processes, without ROS."""

import signal
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.ros import domain
from uav_vslam.ros.domain import MAX_DOMAIN_ID, check_domain, claimed_domain
from waiting import wait_for

HOLDER = """
import signal
from uav_vslam.ros.domain import claimed_domain
with claimed_domain() as domain_id:
    print(domain_id, flush=True)
    signal.pause()
"""


def claim_once() -> int:
    with claimed_domain() as domain_id:
        return domain_id


def test_claims_are_exclusive_and_a_released_domain_is_free_again() -> None:
    with claimed_domain() as first:
        with claimed_domain() as second:
            assert 1 <= min(first, second) < max(first, second) <= MAX_DOMAIN_ID
        with claimed_domain() as third:
            assert third != first


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_another_process_holds_its_domain_until_it_exits_in_any_way(
    monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        held = int(holder.stdout.readline())
        monkeypatch.setattr(domain.os, "getpid", lambda: held - 1)  # search from there
        assert claim_once() != held
        holder.send_signal(number)
        holder.wait()
    assert wait_for(lambda: claim_once() == held)  # somebody else may have it for a while


@pytest.mark.parametrize("index", [0, 1, 7], ids=lambda index: f"participant {index}")
def test_a_domain_with_a_participant_is_skipped(monkeypatch: pytest.MonkeyPatch, index: int) -> None:
    """A later participant alone, too: the first has ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        with claimed_domain() as taken:
            participant.bind(("", 7400 + 250 * taken + 10 + 2 * index))
        monkeypatch.setattr(domain.os, "getpid", lambda: taken - 1)
        assert claim_once() != taken


def test_if_all_domains_are_in_use_the_error_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(domain, "MAX_DOMAIN_ID", 2)
    with ExitStack() as claims, pytest.raises(ConfigError, match="give one with --domain"):
        list(map(claims.enter_context, (claimed_domain() for _ in range(3))))


@pytest.mark.parametrize("text", ["abc", "300", "-1", "1.5"])
def test_an_environment_with_a_domain_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(ConfigError, match=f"ROS_DOMAIN_ID={text} in the environment is not allowed"):
        check_domain(None)
    check_domain(7)  # takes its place


@pytest.mark.parametrize("text", ["", "0", "150", " 5"])
def test_what_ros_can_use_is_left_alone(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    check_domain(None)
