"""A page in a real browser: Chromium without a window, driven by its DevTools over a pipe, with no other package."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from present import present

Message = dict[str, Any]  # what DevTools say
SECONDS = 600.0
PLACED = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(each), fcntl.F_DUPFD, 10) for each in sys.argv[1:3]]
for place, end in enumerate(ends, 3):
    os.dup2(end, place)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""A program that becomes another one, which finds the ends of two pipes where DevTools look for them, at 3 and 4."""
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def browser() -> str | None:
    """Return the program, or None where there is none."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


def require_browser() -> None:
    """Skip a test where there is no browser; fail where SERVOCORE_REQUIRE_BROWSER asks for one."""
    if browser() is not None:
        return
    if os.environ.get("SERVOCORE_REQUIRE_BROWSER"):
        pytest.fail("SERVOCORE_REQUIRE_BROWSER is set, but there is no chromium")
    pytest.skip("needs chromium")


class Page:
    """One page. `errors` collects what the console and the engine complain of."""

    def __init__(self, file: Path, profile: Path, *, width: int = 1280, height: int = 900) -> None:
        to_browser, from_us = os.pipe()
        to_us, from_browser = os.pipe()
        self._write, self._read, self._left, self._number = from_us, to_us, b"", 0
        self.errors: list[str] = []

        command = [present(browser()), "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
                   "--no-first-run", "--disable-dev-shm-usage", "--disable-background-networking", "--hide-scrollbars",
                   f"--user-data-dir={profile}", "about:blank"]  # fmt: skip
        self._process = subprocess.Popen(
            [sys.executable, "-c", PLACED, str(to_browser), str(from_browser), *command],
            pass_fds=(to_browser, from_browser), start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._session = None
        target = next(each for each in self.ask("Target.getTargets")["targetInfos"] if each["type"] == "page")
        self._session = self.ask("Target.attachToTarget", targetId=target["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")
        self.size(width, height)
        self.open(file)

    def open(self, file: Path, javascript: bool = True) -> None:
        """Load a page, with or without its scripts."""
        self.ask("Emulation.setScriptExecutionDisabled", value=not javascript)
        self._loaded = False
        self.ask("Page.navigate", url=file.resolve().as_uri())
        self._until(lambda: self._loaded)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._write)
        os.close(self._read)
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)  # the group of its own that it began: its helpers too
        self._process.wait(10)

    def size(self, width: int, height: int) -> None:
        """Set the size of the window."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                 mobile=width < 500)  # fmt: skip

    def media(self, *, dark: bool = False, kind: str = "") -> None:
        """Look at the page in dark mode, or as it is printed."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.ask("Emulation.setEmulatedMedia", media=kind, features=features)

    def run(self, script: str) -> Any:
        """Return the value of an expression, after its promise."""
        answer = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise AssertionError(answer["exceptionDetails"]["exception"].get("description"))
        return answer["result"].get("value")

    def picture(self, file: Path, whole: bool = True) -> None:
        """Save what is seen."""
        answer = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        file.write_bytes(base64.b64decode(answer["data"]))

    def pdf(self) -> bytes:
        """Return the page as it is printed."""
        return base64.b64decode(self.ask("Page.printToPDF", printBackground=True)["data"])

    def press(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def drag(self, *places: tuple[float, float]) -> None:
        """Move the mouse to the first place, and with its button pressed on to the others."""
        for k, (x, y) in enumerate(places):
            self.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, buttons=int(k > 0), button="left")
            if k == 0 and len(places) > 1:
                self.ask("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
        if len(places) > 1:
            self.ask("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)

    def ask(self, method: str, **parameters: object) -> Message:
        """Send one command and return its answer."""
        self._number += 1
        number, message = self._number, {"id": self._number, "method": method, "params": parameters}
        if getattr(self, "_session", None):
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        answers: list[Message] = []
        self._until(lambda: bool(answers), number, answers)
        if "error" in answers[0]:
            raise AssertionError(f"{method}: {answers[0]['error']}")
        result: Message = answers[0]["result"]
        return result

    def _until(self, done: Callable[[], bool], number: int = 0, answers: list[Message] | None = None) -> None:
        end = time.monotonic() + SECONDS
        while not done():
            while b"\0" not in self._left:
                if not select.select([self._read], [], [], max(end - time.monotonic(), 0.0))[0]:
                    raise TimeoutError("the browser does not answer")
                chunk = os.read(self._read, 1 << 20)
                if not chunk:
                    raise EOFError("the browser has ended")
                self._left += chunk
            line, _, self._left = self._left.partition(b"\0")
            message = json.loads(line)
            if answers is not None and message.get("id") == number:
                answers.append(message)
            self._note(message)

    def _note(self, message: Message) -> None:
        method, told = message.get("method"), message.get("params", {})
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Runtime.exceptionThrown":
            self.errors.append(told["exceptionDetails"].get("exception", {}).get("description", "exception"))
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert", "warning"):
            self.errors.append(str(told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.errors.append(told["entry"]["text"])
