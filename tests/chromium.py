"""A page in headless Chromium, driven over a pipe with the Chrome DevTools Protocol.

The protocol over two pipes (--remote-debugging-pipe) needs no driver, no package and no socket:
messages are JSON with a NUL at the end, on the browser's descriptors 3 and 4.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-extensions", "--disable-dev-shm-usage", "--remote-debugging-pipe",
)  # fmt: skip
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 30.0
CODES = {"ArrowLeft": 37, "ArrowRight": 39, "Home": 36, "End": 35, "Escape": 27, "Tab": 9}


def browser() -> str | None:
    """The path of a Chromium; None if there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page:
    """One tab; `complaints` collects exceptions, console errors and refused loads."""

    def __init__(self, incoming: int, outgoing: int) -> None:
        self._in, self._out = incoming, outgoing
        self._buffer = b""
        self._count = 0
        self._session: str | None = None
        self._events: list[dict[str, Any]] = []
        self.complaints: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def open(self, path: Path, width: int, height: int = 900) -> None:
        """Load a file at a width in CSS pixels and wait until it is there."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self._events.clear()
        self.call("Page.navigate", url=path.resolve().as_uri())
        self._until(lambda: any(e["method"] == "Page.loadEventFired" for e in self._events))
        self.run("new Promise(requestAnimationFrame)")

    def run(self, expression: str) -> Any:
        """The value of a JavaScript expression, awaited."""
        asked = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self.call("Runtime.evaluate", **asked)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def click(self, selector: str) -> None:
        """Press and release the mouse in the middle of the first element of a selector."""
        place = self.middle(selector)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **place)

    def move(self, x: float, y: float) -> None:
        """Move the mouse to a place in the window."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def middle(self, selector: str) -> dict[str, float]:
        """The middle of an element, scrolled into view."""
        name = json.dumps(selector)
        self.run(f"document.querySelector({name}).scrollIntoView({{block: 'center'}})")
        self.run("new Promise(requestAnimationFrame)")
        box = f"document.querySelector({name}).getBoundingClientRect()"
        found: dict[str, float] = self.run(
            f"(b => ({{x: b.x + b.width / 2, y: b.y + b.height / 2}}))({box})"
        )
        return found

    def press(self, key: str) -> None:
        """Press and release a key, such as ArrowLeft, or a space."""
        told: dict[str, Any] = {"key": key, "windowsVirtualKeyCode": CODES.get(key, 32)}
        if key == " ":
            told |= {"code": "Space", "text": " "}
        self.call("Input.dispatchKeyEvent", type="keyDown", **told)
        told.pop("text", None)
        self.call("Input.dispatchKeyEvent", type="keyUp", **told)

    def picture(self, path: Path) -> None:
        """Write a PNG of the whole page."""
        answer = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(answer["data"]))

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its answer."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        answers: list[dict[str, Any]] = []
        self._until(lambda: bool(answers), answers)
        if "error" in answers[0]:
            raise AssertionError(f"{method}: {answers[0]['error']}")
        result: dict[str, Any] = answers[0].get("result", {})
        return result

    def _until(self, done: Any, answers: list[dict[str, Any]] | None = None) -> None:
        end = time.monotonic() + PATIENCE
        while not done():
            for message in self._receive(end - time.monotonic()):
                if message.get("id") == self._count and answers is not None:
                    answers.append(message)
                elif "method" in message:
                    self._events.append(message)
                    self._listen(message["method"], message["params"])

    def _receive(self, patience: float) -> list[dict[str, Any]]:
        if patience <= 0 or not select.select([self._in], [], [], patience)[0]:
            raise AssertionError(f"no answer from the browser within {PATIENCE:g} s")
        chunk = os.read(self._in, 1 << 20)
        if not chunk:
            raise AssertionError("the browser has closed the pipe")
        *whole, self._buffer = (self._buffer + chunk).split(b"\0")
        return [json.loads(text) for text in whole]

    def _listen(self, method: str, told: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(told["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning"):
            self.complaints.append(json.dumps(told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.complaints.append(told["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = told["request"]["url"]
            if not url.startswith(("file:", "data:", "about:")):
                self.complaints.append(f"asked for {url}")


@contextmanager
def chromium(path: str) -> Iterator[Page]:
    """Start a browser with an empty profile and end it."""
    to_browser, from_us = os.pipe()
    to_us, from_browser = os.pipe()
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as profile:
        with Path(profile, "log").open("w") as log:
            actions = [
                (os.POSIX_SPAWN_DUP2, log.fileno(), 1),
                (os.POSIX_SPAWN_DUP2, log.fileno(), 2),
                (os.POSIX_SPAWN_DUP2, to_browser, 3),
                (os.POSIX_SPAWN_DUP2, from_browser, 4),
            ]
            command = [path, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
            process = os.posix_spawn(path, command, dict(os.environ), file_actions=actions)
        os.close(to_browser)
        os.close(from_browser)
        try:
            page = Page(to_us, from_us)
            yield page
            page._session = None
            page.call("Browser.close")
        finally:
            os.close(from_us)
            os.close(to_us)
            os.waitpid(process, 0)
