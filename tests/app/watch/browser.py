"""A real browser: Chromium without a window, steered by its DevTools protocol."""

import base64
import json
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.sync.client import ClientConnection, connect

from tests.phone_screen import BROWSER, QUIET

_STARTING = 30.0
_ANSWERING = 20.0


class Page:
    """One tab."""

    def __init__(self, socket: ClientConnection):
        self._socket = socket
        self._number = 0
        self.log: list[dict[str, Any]] = []
        """What the browser told by itself."""
        for domain in ("Page", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: object) -> dict[str, Any]:
        """Call a method of the protocol, and return its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            said = json.loads(self._socket.recv(_ANSWERING))
            if said.get("id") == self._number:
                assert "error" not in said, said
                return said["result"]
            self.log.append(said)

    def open(self, address: str) -> None:
        self.send("Page.navigate", url=address)

    def ask(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        found = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, expression: str, seconds: float = 15.0) -> Any:
        """Wait until an expression is true."""
        deadline = time.monotonic() + seconds
        tried = f"(() => {{ try {{ return {expression}; }} catch {{ return false; }} }})()"  # not loaded yet
        while not (value := self.ask(tried)):
            assert time.monotonic() < deadline, (expression, self.ask("document.body.innerText"))
            time.sleep(0.02)
        return value

    def text(self, name: str) -> str:
        return self.ask(f"document.getElementById({name!r}).innerText")

    def place(self, selector: str) -> dict[str, float]:
        """Left, top, width and height in the window [px]."""
        return self.ask(
            f"(() => {{ const r = document.querySelector({selector!r}).getBoundingClientRect();"
            " return { x: r.x, y: r.y, width: r.width, height: r.height }; })()"
        )

    def click(self, selector: str) -> float:
        """A click as of a mouse; returns when it was sent [s, monotonic]."""
        box = self.place(selector)
        at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        begun = time.monotonic()
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)
        return begun

    def space(self) -> float:
        """The space bar; returns when it was pressed [s, monotonic]."""
        begun = time.monotonic()
        for kind in ("keyDown", "keyUp"):
            self.send(
                "Input.dispatchKeyEvent", type=kind, key=" ", code="Space", windowsVirtualKeyCode=32, text=" "
            )
        return begun

    def size(self, width: int, height: int) -> None:
        """Size of the window [px]."""
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 500,
        )  # fmt: skip

    def picture(self, path: Path) -> None:
        """What the window shows, as PNG."""
        path.write_bytes(base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"]))

    @property
    def errors(self) -> list[str]:
        """Errors of scripts, and what the content security policy refused."""
        self.ask("1")
        return [
            json.dumps(said["params"])
            for said in self.log
            if said["method"] == "Runtime.exceptionThrown"
            or (said["method"] == "Log.entryAdded" and said["params"]["entry"]["source"] == "security")
        ]


@contextmanager
def browser() -> Iterator[Page]:
    """A browser with one empty page; the test is skipped where there is none."""
    if BROWSER is None:
        pytest.skip("no browser is installed: chromium or google-chrome")
    with tempfile.TemporaryDirectory(prefix="eldir-browser-", ignore_cleanup_errors=True) as folder:
        options = [
            *QUIET,
            "--disable-dev-shm-usage",
            "--remote-debugging-port=0",
            f"--user-data-dir={folder}",
        ]
        with subprocess.Popen(
            [BROWSER, *options, "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as process:
            try:
                address = _first_tab(Path(folder))
                with connect(address, max_size=1 << 26, compression=None) as socket:
                    yield Page(socket)
            finally:
                os.killpg(process.pid, signal.SIGKILL)


def _first_tab(folder: Path) -> str:
    """Address of the socket that steers the first tab."""
    deadline = time.monotonic() + _STARTING
    while time.monotonic() < deadline:
        try:
            port = int((folder / "DevToolsActivePort").read_text().split()[0])
            with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=5) as answer:
                tabs = json.loads(answer.read())
            return next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
        except (OSError, IndexError, StopIteration, ValueError):
            time.sleep(0.05)
    raise AssertionError("the browser does not start")
