"""A real Chromium, driven by its own DevTools protocol over a pair of pipes: no driver, no library, no port."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from select import select
from typing import Any

from support.rounds import QUICK

_NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = None if QUICK else next(filter(None, map(shutil.which, _NAMES)), None)
PATIENCE_S = 45.0
"""Also for its start, on a machine that is busy with other tests."""
_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--hide-scrollbars", "--mute-audio"),
    *("--disable-dev-shm-usage", "--no-first-run", "--disable-background-networking"),
    *("--disable-site-isolation-trials", "--disable-features=IsolateSandboxedIframes,IsolateOrigins,site-per-process"),
)
"""All frames of a page in one process, so that what they complain about is heard. `--no-sandbox` is for
root in a container, which is what runs the tests."""

_GRAPHICS = "--use-angle=swiftshader", "--enable-unsafe-swiftshader"
"""WebGL in software, and all else is drawn by it, too: twice the time of processors."""
_NO_GRAPHICS = "--disable-gpu", "--disable-software-rasterizer"


class Page:
    """One page, with what its console said and what its policy refused in `complaints`."""

    def __init__(self, read_fd: int, write_fd: int) -> None:
        self._read_fd, self._write_fd = read_fd, write_fd
        self._buffer = b""
        self._last = 0
        self._session = ""
        self.complaints: list[str] = []
        self._contexts: dict[int, str] = {}
        """Where scripts run: by its number the frame of each."""
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page", "Audits"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters: Any) -> Mapping[str, Any]:
        """One command and its answer; events on the way are looked at."""
        self._last += 1
        asked: dict[str, Any] = {"id": self._last, "method": method, "params": parameters}
        if self._session:
            asked["sessionId"] = self._session
        os.write(self._write_fd, json.dumps(asked).encode() + b"\0")
        deadline = time.monotonic() + PATIENCE_S
        while True:
            message = self._next(deadline)
            if message.get("id") == self._last:
                assert "error" not in message, (method, message["error"])
                return message["result"]
            self._hear(message)

    def open(self, address: str) -> None:
        """Goes there, and waits until its script has run."""
        self.ask("Page.navigate", url=address)
        self.until("document.readyState === 'complete'")

    def run(self, script: str, *, within: int | None = None) -> Any:
        """The value of an expression in the page, or in one of its frames; a promise is awaited."""
        place = {} if within is None else {"contextId": within}
        answer = self.ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True, **place)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def frames(self, script: str) -> list[int]:
        """The frames below the page where an expression is true, for `within`, in the order in which they came."""
        self.run("0")  # hears what has come or gone
        main = self.ask("Page.getFrameTree")["frameTree"]["frame"]["id"]
        below = [context for context, frame in self._contexts.items() if frame != main]
        return [context for context in below if context in self._contexts and self.run(script, within=context)]

    def until(self, script: str, patience_s: float = PATIENCE_S, *, within: int | None = None) -> Any:
        """Waits until an expression is true, and gives its value."""
        deadline = time.monotonic() + patience_s
        while not (found := self.run(script, within=within)):
            assert time.monotonic() < deadline, f"waited {patience_s} s in vain for: {script}"
            time.sleep(0.05)
        return found

    def look(self, *, width: int = 1440, height: int = 900, dark: bool = False) -> None:
        """How large the window is, and what its user prefers."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", features=[scheme])

    def press(self, key: str) -> None:
        """A key, down and up."""
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, text=key if kind == "keyDown" else "")

    def click(self, x: float, y: float) -> None:
        """The mouse, pressed and released, at a place of the window."""
        for kind in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def drag(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """The mouse, pressed at one place of the window, moved to another, and released there."""
        ways = (("mousePressed", begin), ("mouseMoved", end), ("mouseReleased", end))
        for kind, (x, y) in ways:
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def rectangle(self, of: str) -> tuple[float, float, float, float]:
        """Left, top, width and height of the first element of a selector."""
        script = "(({left, top, width, height}) => [left, top, width, height])"
        left, top, width, height = self.run(f"{script}(document.querySelector({of!r}).getBoundingClientRect())")
        return left, top, width, height

    def picture(self, path: Path, of: str = "") -> None:
        """Saves what is seen, or the first element of a selector, as what its name says: a JPEG has half of a PNG's
        bytes, 80 kB.
        """
        kind: dict[str, Any] = {"format": "jpeg", "quality": 80} if path.suffix == ".jpg" else {"format": "png"}
        if of:
            clip = dict(zip(("x", "y", "width", "height"), self.rectangle(of), strict=True))
            kind["clip"] = {**clip, "scale": 1}
        taken = self.ask("Page.captureScreenshot", **kind)
        path.write_bytes(base64.b64decode(taken["data"]))

    def _next(self, deadline: float) -> Mapping[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select([self._read_fd], [], [], max(deadline - time.monotonic(), 0.0))
            assert ready, "the browser does not answer"
            more = os.read(self._read_fd, 1 << 20)
            assert more, "the browser has ended"
            self._buffer += more
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)

    def _hear(self, message: Mapping[str, Any]) -> None:
        method, said = message.get("method"), message.get("params", {})
        if method == "Runtime.executionContextCreated" and said["context"]["auxData"].get("isDefault"):
            self._contexts[said["context"]["id"]] = said["context"]["auxData"]["frameId"]
        elif method == "Runtime.executionContextDestroyed":
            self._contexts.pop(said["executionContextId"], None)
        elif method == "Runtime.executionContextsCleared":
            self._contexts.clear()
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(said["exceptionDetails"])[:500])
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning", "assert"):
            self.complaints.append(json.dumps(said["args"])[:500])
        elif method == "Log.entryAdded" and said["entry"]["level"] in ("error", "warning"):
            self.complaints.append(f"{said['entry']['text']} {said['entry'].get('url', '')}"[:500])
        elif method == "Audits.issueAdded" and said["issue"]["code"] == "ContentSecurityPolicyIssue":
            self.complaints.append(json.dumps(said["issue"])[:500])


@contextmanager
def browsing(*, graphics: bool = False) -> Iterator[Page]:
    """A browser with one page, for the time of a block; `graphics`: with WebGL, which the panel of space needs."""
    assert CHROMIUM, "needs Chromium"
    to_browser, from_us = os.pipe()
    to_us, from_browser = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [
            CHROMIUM,
            *_OPTIONS,
            *(_GRAPHICS if graphics else _NO_GRAPHICS),
            f"--user-data-dir={profile}",
            "about:blank",
        ]
        # It reads commands at 3 and writes answers at 4; bash puts the pipes there, whatever their numbers are.
        moved = ["bash", "-c", f'exec 3<&{to_browser} 4>&{from_browser}; exec "$@"', "bash", *command]
        nothing = subprocess.DEVNULL
        process = subprocess.Popen(
            moved, pass_fds=(to_browser, from_browser), stdin=nothing, stdout=nothing, stderr=nothing
        )
        os.close(to_browser)
        os.close(from_browser)
        try:
            yield Page(to_us, from_us)
        finally:
            process.terminate()  # its other processes end with it
            process.wait(PATIENCE_S)
            os.close(to_us)
            os.close(from_us)
