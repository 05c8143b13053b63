# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium that tests drive through a pipe; it tells what pages asked for and complained of."""

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--no-first-run", "--hide-scrollbars", "--mute-audio"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),  # WebGL without a graphics card
    *("--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
TIMEOUT_S = 120.0


@dataclass(slots=True)
class Browser:
    """One page of a running browser.

    Attributes:
        requests: addresses asked for since the page was opened.
        complaints: errors and warnings that the page wrote to the console, and exceptions.
    """

    _read: int
    _write: int
    _session: str = ""
    _number: int = 0
    _left: bytes = b""
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def start(self) -> None:
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def open(self, page: Path, *, width: int = 1280, height: int = 900, scheme: str = "light") -> float:
        """Open a page and return the seconds until it said that it is ready."""
        self.requests.clear()
        self.complaints.clear()
        self.resize(width, height)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        began_s = time.monotonic()
        self.call("Page.navigate", url=page.resolve().as_uri())
        while not self.evaluate("document.documentElement?.dataset.ready ?? ''"):
            assert time.monotonic() - began_s < TIMEOUT_S, f"{page} is not ready: {self.complaints}"
            time.sleep(0.05)
        return time.monotonic() - began_s

    def resize(self, width: int, height: int) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def picture(self, path: Path, *, whole: bool = False) -> Path:
        """Write what is seen, or the whole page, as PNG."""
        data = self.call("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))
        return path

    def call(self, method: str, **parameters: Any) -> Any:
        """Send a command and return its answer; what the page reports meanwhile is recorded."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        for answer in self._messages():
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._note(answer)
        raise AssertionError("the browser ended")

    def _messages(self) -> Iterator[dict[str, Any]]:
        while True:
            while b"\0" in self._left:
                content, _, self._left = self._left.partition(b"\0")
                yield json.loads(content)
            part = os.read(self._read, 1 << 20)
            if not part:
                return
            self._left += part

    def _note(self, event: dict[str, Any]) -> None:
        what, parameters = event.get("method"), event.get("params", {})
        if what == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif what == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
            self.complaints.append(str([argument.get("value") for argument in parameters["args"]]))
        elif what == "Runtime.exceptionThrown":
            self.complaints.append(str(parameters["exceptionDetails"]))
        elif what == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
            self.complaints.append(str(parameters["entry"]))


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """Run a browser with a new profile in a folder."""
    assert CHROMIUM is not None
    to_browser, write = os.pipe()
    read, from_browser = os.pipe()

    def descriptors() -> None:  # the pipe is expected at 3 and 4
        kept = os.dup(to_browser), os.dup(from_browser)
        os.dup2(kept[0], 3)
        os.dup2(kept[1], 4)

    command = [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--remote-debugging-pipe", "about:blank"]
    process = subprocess.Popen(
        command,
        preexec_fn=descriptors,
        close_fds=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(to_browser)
    os.close(from_browser)
    try:
        page = Browser(read, write)
        page.start()
        yield page
    finally:
        process.terminate()
        process.wait(30)
        os.close(read)
        os.close(write)
