"""A real browser, driven over the WebDriver protocol with nothing but the standard library: Chromium, without a window.

Tests that need it are skipped where `chromium` and `chromedriver` are not found (on Debian: chromium, chromium-driver).
"""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)
LOADED = 60.0
"""Seconds that a page may take to be shown."""
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"  # the key the protocol gives an element's name by


class Browser:
    """One window."""

    def __init__(self, session: str) -> None:
        self._session = session

    def open(self, file: Path) -> None:
        """Open a page, and wait until it is the one that is shown: on a busy machine the driver may answer before."""
        url = file.resolve().as_uri()
        _send(f"{self._session}/url", {"url": url})
        end = time.monotonic() + LOADED
        while not self._shows(url):
            if time.monotonic() > end:
                raise TimeoutError(f"{url} was not shown within {LOADED:.0f} seconds")
            time.sleep(0.05)

    def _shows(self, url: str) -> bool:
        """Whether that page is there as a whole."""
        shown, state = self.run("return [document.URL, document.readyState]")
        return state == "complete" and urllib.parse.unquote(shown.split("#")[0]) == urllib.parse.unquote(url)

    def run(self, script: str, *args: Any) -> Any:
        """What a JavaScript function's body returns."""
        return _send(f"{self._session}/execute/sync", {"script": script, "args": list(args)})

    def click(self, selector: str) -> None:
        """Press the first element of that CSS selector, as a user would."""
        element = _send(f"{self._session}/element", {"using": "css selector", "value": selector})[ELEMENT]
        _send(f"{self._session}/element/{element}/click", {})

    def resize(self, width: int, height: int) -> None:
        _send(f"{self._session}/window/rect", {"width": width, "height": height})

    def emulate(self, width: int, height: int) -> None:
        """Pretend to be a screen of that size in CSS pixels, narrower than any window may be."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        _send(f"{self._session}/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": metrics})

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(_send(f"{self._session}/screenshot")))

    def log(self, kind: str) -> list[dict[str, Any]]:
        """What was written since: to the console ("browser"), or about requests ("performance")."""
        entries: list[dict[str, Any]] = _send(f"{self._session}/se/log", {"type": kind})
        return entries

    def requests(self) -> list[str]:
        """Addresses asked for since."""
        messages = [json.loads(entry["message"])["message"] for entry in self.log("performance")]
        return [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]


@contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """A browser with a fresh profile in an empty folder."""
    assert CHROMIUM and DRIVER
    driver = subprocess.Popen([DRIVER, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        server = f"http://127.0.0.1:{_port(driver)}"
        options = {"binary": CHROMIUM, "args": [*FLAGS, f"--user-data-dir={profile}", "about:blank"]}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"}}
        session = _send(f"{server}/session", {"capabilities": {"alwaysMatch": wanted}})["sessionId"]
        try:
            opened = Browser(f"{server}/session/{session}")
            opened.run("return document.readyState")
            opened.requests()  # those of its own first page
            yield opened
        finally:
            _send(f"{server}/session/{session}", method="DELETE")
    finally:
        driver.terminate()
        driver.communicate()


def _port(driver: subprocess.Popen[str]) -> int:
    """The one it says it took."""
    assert driver.stdout is not None
    deadline = time.monotonic() + 60
    for line in driver.stdout:
        if "started successfully on port" in line:
            return int(line.rstrip(".\n").rpartition(" ")[2])
        assert time.monotonic() < deadline
    raise RuntimeError("chromedriver ended before it listened")


def _send(url: str, data: Any = None, method: str | None = None) -> Any:
    body = None if data is None else json.dumps(data).encode()
    request = urllib.request.Request(url, body, {"Content-Type": "application/json"}, method=method)
    try:
        with urllib.request.urlopen(request, timeout=120) as answer:
            return json.load(answer)["value"]
    except urllib.error.HTTPError as error:
        raise RuntimeError(json.load(error)["value"]["message"]) from error
