"""A small WebDriver client: enough to open a page in headless Chromium, click, press keys and look at it."""

from __future__ import annotations

import base64
import json
import os
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
PATIENCE_S = 120.0
"""How long a page may take to do something: machines that run tests can be very busy."""
KEYS = {
    "left": "\ue012",
    "up": "\ue013",
    "right": "\ue014",
    "down": "\ue015",
    "tab": "\ue004",
    "escape": "\ue00c",
}


def missing() -> str:
    """What is missing to run a browser here, or an empty string."""
    lacking = []
    if shutil.which("chromedriver") is None:
        lacking.append("chromedriver")
    if not any(map(shutil.which, _BROWSERS)):
        lacking.append("chromium")
    return " and ".join(lacking)


class Browser:
    """Headless Chromium with one window. Use as a context manager.

    Parameters
    ----------
    width, height : int
        Size of the viewport in CSS pixels.
    dark : bool
        Whether the system is said to prefer dark pages.
    scale : float
        Device pixels per CSS pixel.
    """

    def __init__(self, width: int = 1280, height: int = 900, dark: bool = False, scale: float = 1.0) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self._server = f"http://127.0.0.1:{port}"
        self._driver = subprocess.Popen(
            ["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        self._dark = dark
        self._session = ""

    def __enter__(self) -> Browser:
        flags = ["--headless=new", "--hide-scrollbars", "--disable-gpu"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            flags.append("--no-sandbox")  # Chromium refuses its sandbox to root
        binary = next(path for name in _BROWSERS if (path := shutil.which(name)))
        options = {"args": flags, "binary": binary}
        capabilities = {
            "alwaysMatch": {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        }
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                made = self._ask("POST", "/session", {"capabilities": capabilities})
                break
            except urllib.error.URLError:
                if time.monotonic() > deadline:
                    self.close()
                    raise
                time.sleep(0.1)
        self._session = f"/session/{made['sessionId']}"
        self._devtools("Emulation.setDeviceMetricsOverride", self._size)
        self._devtools("Performance.enable", {"timeDomain": "threadTicks"})
        scheme = {"name": "prefers-color-scheme", "value": "dark" if self._dark else "light"}
        self._devtools("Emulation.setEmulatedMedia", {"features": [scheme]})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the browser and its driver."""
        try:
            if self._session:
                self._ask("DELETE", self._session)
        finally:
            self._driver.terminate()
            self._driver.wait(timeout=30)

    def open(self, path: Path) -> None:
        """Load a file."""
        self._ask("POST", self._session + "/url", {"url": path.resolve().as_uri()})

    def run(self, code: str, *arguments: Any) -> Any:
        """Run JavaScript in the page; `return` hands a value back."""
        return self._ask("POST", self._session + "/execute/sync", {"script": code, "args": list(arguments)})

    def wait(self, code: str, seconds: float = PATIENCE_S) -> Any:
        """Run JavaScript again and again until it returns something true."""
        deadline = time.monotonic() + seconds
        while not (value := self.run(code)):
            assert time.monotonic() < deadline, f"never came true: {code}"
            time.sleep(0.05)
        return value

    def text(self, selector: str) -> str:
        """Text of an element."""
        return str(self.run("return document.querySelector(arguments[0]).textContent", selector))

    def click(self, selector: str) -> None:
        """Click an element in its middle, as a hand would: it must be visible and not covered."""
        centre = "{block: 'center', behavior: 'instant'}"
        self.run(f"document.querySelector(arguments[0]).scrollIntoView({centre})", selector)
        self._ask("POST", f"{self._element(selector)}/click", {})

    def type(self, selector: str, text: str) -> None:
        """Press keys in an element."""
        self._ask("POST", f"{self._element(selector)}/value", {"text": text})

    def messages(self) -> list[str]:
        """Warnings and errors of the page's console, scripts that failed included."""
        log = self._ask("POST", self._session + "/se/log", {"type": "browser"})
        return [entry["message"] for entry in log if entry["level"] in ("WARNING", "SEVERE")]

    def processor_s(self) -> float:
        """Seconds of processor time that the page has taken so far: what other processes do does not count."""
        told = self._devtools("Performance.getMetrics", {})["metrics"]
        return float(next(entry["value"] for entry in told if entry["name"] == "TaskDuration"))

    def screenshot(self, path: Path, whole: bool = False) -> None:
        """Write a PNG of the viewport, or of the whole page."""
        shot = self._devtools("Page.captureScreenshot", {"captureBeyondViewport": whole})
        path.write_bytes(base64.b64decode(shot["data"]))

    def _element(self, selector: str) -> str:
        found = self._ask("POST", self._session + "/element", {"using": "css selector", "value": selector})
        return f"{self._session}/element/{found[_ELEMENT]}"

    def _devtools(self, command: str, parameters: dict[str, Any]) -> Any:
        return self._ask("POST", self._session + "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def _ask(self, method: str, path: str, body: Any = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self._server + path, data, {"Content-Type": "application/json"}, method=method
        )
        try:
            with urllib.request.urlopen(request, timeout=2 * PATIENCE_S) as answer:
                return json.loads(answer.read())["value"]
        except urllib.error.HTTPError as error:
            said = json.loads(error.read())["value"]
            raise AssertionError(f"{said['error']}: {said['message'].splitlines()[0]}") from None
