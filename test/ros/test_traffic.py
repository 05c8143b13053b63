# SPDX-License-Identifier: Apache-2.0
"""Rates follow the counters, and the kernel's counters are those of the named interface."""

import shutil
import socket
from pathlib import Path

import pytest

from uav_vslam.errors import ConfigError
from uav_vslam.ros.traffic import Interface, Rate
from uav_vslam.types import NS_PER_S


def test_a_rate_needs_two_values() -> None:
    assert Rate().update(5, 1000) == 0.0


def test_a_steady_counter_has_its_rate_from_the_second_value_on() -> None:
    rate = Rate(window_s=3.0)
    assert [rate.update(t * NS_PER_S, 900 * t) for t in range(1, 10)] == [0.0, *[900.0] * 8]


def test_values_older_than_the_window_are_dropped() -> None:
    rate = Rate(window_s=3.0)
    found = [rate.update(t * NS_PER_S, 1000 * min(t, 5)) for t in range(12)]
    assert found[5] == 1000.0
    assert found[7] == pytest.approx(1000 / 3)
    assert found[8:] == [0.0] * 4


def test_values_rarer_than_the_window_still_have_a_rate() -> None:
    rate = Rate(window_s=3.0)
    assert [rate.update(t * NS_PER_S, 10 * t) for t in (0, 100, 200)] == [0.0, 10.0, 10.0]


def test_a_clock_that_is_set_back_resets_the_window() -> None:
    rate = Rate()
    for t in (100, 101, 102):
        rate.update(t * NS_PER_S, t)
    assert rate.update(1 * NS_PER_S, 103) == 0.0
    assert rate.update(2 * NS_PER_S, 110) == 7.0


def test_an_interface_counts_what_is_sent_over_it() -> None:
    loopback = Interface("lo")
    before = (loopback.sent_bytes, loopback.received_bytes)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(10):
            sender.sendto(bytes(1000), ("127.0.0.1", 9))
    assert loopback.sent_bytes >= before[0] + 10_000
    assert loopback.received_bytes >= before[1] + 10_000


@pytest.mark.parametrize(
    ("state", "down"), [("up", False), ("unknown", False), ("down", True), ("lowerlayerdown", True)]
)
def test_an_interface_is_down_if_the_kernel_says_so(
    state: str, down: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wlan0").mkdir()
    (tmp_path / "wlan0" / "operstate").write_text(f"{state}\n")
    monkeypatch.setattr("uav_vslam.ros.traffic.INTERFACES", tmp_path)
    assert Interface("wlan0").is_down is down


def test_an_interface_that_is_unplugged_is_down_and_goes_on_counting_once_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uav_vslam.ros.traffic.INTERFACES", tmp_path)

    def plug_in(sent: int) -> None:
        (tmp_path / "wlan0" / "statistics").mkdir(parents=True)
        (tmp_path / "wlan0" / "operstate").write_text("up\n")
        (tmp_path / "wlan0" / "statistics" / "tx_bytes").write_text(f"{sent}\n")

    plug_in(1000)
    interface = Interface("wlan0")
    assert interface.sent_bytes == 1000
    shutil.rmtree(tmp_path / "wlan0")
    assert interface.is_down
    assert interface.sent_bytes == 1000
    plug_in(200)
    assert not interface.is_down
    assert interface.sent_bytes == 1200


@pytest.mark.parametrize("name", ["radio0", "../lo"])
def test_an_unknown_interface_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(ConfigError, match=r"no network interface of this host \(.*lo"):
        Interface(name)
