# SPDX-License-Identifier: Apache-2.0
"""Two computers in one: network namespaces, connected by a link that stands for the radio. Needs root."""

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

VEHICLES = ("uav1", "uav2")


def unavailable(*tools: str) -> str:
    """Return why namespaces can't be used here; empty if they can."""
    if os.environ.get("UAV_VSLAM_NETNS") != "1":
        return "opt-in: set UAV_VSLAM_NETNS=1"
    if os.geteuid() != 0 or any(shutil.which(tool) is None for tool in tools):
        return f"needs root and {', '.join(tools)}"
    probe = f"uav_probe_{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", probe], capture_output=True).returncode == 0
    gone = made and subprocess.run(["ip", "netns", "delete", probe], capture_output=True).returncode == 0
    return "" if gone else "may make no network namespaces"


@dataclass
class Host:
    """A vehicle's network namespace; index 1 or 2 makes its names and addresses."""

    index: int

    @property
    def vehicle(self) -> str:
        return VEHICLES[self.index - 1]

    @property
    def namespace(self) -> str:
        return f"vslam_{self.vehicle}"

    @property
    def interface(self) -> str:
        return f"radio{self.index}"

    @property
    def address(self) -> str:
        return f"10.77.0.{self.index}"

    def inside(self, *command: str) -> list[str]:
        """Return the command that runs another one on this host."""
        return ["ip", "netns", "exec", self.namespace, *command]

    def run(self, *command: str, text: str | None = None) -> str:
        done = subprocess.run(self.inside(*command), input=text, capture_output=True, text=True, check=True)
        return done.stdout


@contextmanager
def connected(made: Sequence[Host], *, rate_bit: int, burst_bytes: int, queue_bytes: int) -> Iterator[None]:
    """Keep two hosts, connected by a link of that rate."""
    try:
        for host in made:
            subprocess.run(["ip", "netns", "delete", host.namespace], capture_output=True)  # of a run that was killed
            subprocess.run(["ip", "netns", "add", host.namespace], check=True)
        a, b = made
        ends = ["name", b.interface, "netns", b.namespace]
        link = ["ip", "link", "add", a.interface, "netns", a.namespace, "type", "veth", "peer", *ends]
        subprocess.run(link, check=True)
        for host in made:
            host.run("sysctl", "-qw", "net.ipv6.conf.all.disable_ipv6=1")  # else the kernel itself would use the radio
            host.run("ip", "address", "add", f"{host.address}/24", "dev", host.interface)
            for interface in ("lo", host.interface):
                host.run("ip", "link", "set", interface, "up")
            shape = ["rate", f"{rate_bit}bit", "burst", str(burst_bytes), "limit", str(queue_bytes)]
            host.run("tc", "qdisc", "add", "dev", host.interface, "root", "tbf", *shape)
        yield
    finally:
        for host in made:
            subprocess.run(["ip", "netns", "delete", host.namespace], capture_output=True)
