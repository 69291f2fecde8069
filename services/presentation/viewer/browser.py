"""Drives a headless Chromium through chromedriver's HTTP interface (W3C WebDriver) with the standard library only."""

import base64
import json
import pathlib
import shutil
import socket
import subprocess
import tempfile
import time
import urllib.error
import urllib.request

CHROMIUM_FLAGS = [
    "--headless=new",
    "--no-sandbox",
    # No GPU is needed: SwiftShader renders WebGL in software.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    # No request but those of the page.
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-domain-reliability",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
]


class BrowserError(RuntimeError):
    """The browser or its driver failed."""


def find_programs():
    """Paths of chromium and chromedriver, or None where either is missing."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    return (chromium, driver) if chromium and driver else None


def _free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Browser:
    """One headless window. Use as a context manager: nothing stays behind."""

    def __init__(self, width=1280, height=800, dark=False, scale=1):
        programs = find_programs()
        if programs is None:
            raise BrowserError("chromium or chromedriver is not installed (apt: chromium chromium-driver)")
        chromium, driver = programs
        self._profile = tempfile.TemporaryDirectory(prefix="pleat-browser-", ignore_cleanup_errors=True)
        port = _free_port()
        self._base = f"http://127.0.0.1:{port}"
        self._driver = subprocess.Popen(
            [driver, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._session = None
        try:
            self._wait_for_driver()
            flags = [
                *CHROMIUM_FLAGS,
                f"--user-data-dir={self._profile.name}",
                f"--window-size={width},{height}",
                f"--force-device-scale-factor={scale}",
            ]
            answer = self._call(
                "POST",
                "/session",
                {
                    "capabilities": {
                        "alwaysMatch": {
                            "browserName": "chrome",
                            "goog:chromeOptions": {"binary": chromium, "args": flags},
                            "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
                            "timeouts": {"script": 600000, "pageLoad": 600000},
                        }
                    }
                },
            )
            self._session = f"/session/{answer['sessionId']}"
            self.devtools(
                "Emulation.setDeviceMetricsOverride",
                {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False},
            )
            scheme = "dark" if dark else "light"
            self.devtools("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})
        except BaseException:
            self.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        if self._session:
            try:
                self._call("DELETE", self._session)
            except BrowserError:
                pass
            self._session = None
        self._driver.terminate()
        try:
            self._driver.wait(10)
        except subprocess.TimeoutExpired:
            self._driver.kill()
            self._driver.wait()
        self._profile.cleanup()

    def _wait_for_driver(self):
        deadline = time.monotonic() + 30
        while True:
            try:
                if self._call("GET", "/status")["ready"]:
                    return
            except BrowserError:
                if time.monotonic() > deadline or self._driver.poll() is not None:
                    raise
            time.sleep(0.05)

    def _call(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self._base + path, data=data, method=method, headers={"Content-Type": "application/json"}
        )
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        try:
            with opener.open(request, timeout=660) as response:
                return json.load(response)["value"]
        except urllib.error.HTTPError as error:
            reason = json.load(error).get("value", {}).get("message", "").splitlines()
            raise BrowserError(f"{method} {path}: {reason[0] if reason else error}") from None
        except OSError as error:
            raise BrowserError(f"{method} {path}: {error}") from None

    def open(self, page):
        """Opens a file (path) or an address, anew even where only the fragment differs."""
        self._call("POST", f"{self._session}/url", {"url": "about:blank"})
        address = page if "://" in str(page) else pathlib.Path(page).resolve().as_uri()
        self._call("POST", f"{self._session}/url", {"url": address})

    def run(self, script, *arguments):
        """Runs JavaScript as a function body and returns its value."""
        return self._call("POST", f"{self._session}/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, condition, seconds=60):
        """Waits until the JavaScript expression is true."""
        deadline = time.monotonic() + seconds
        while not self.run(f"return Boolean({condition})"):
            if time.monotonic() > deadline:
                raise BrowserError(f"not true after {seconds} s: {condition}")
            time.sleep(0.05)

    def devtools(self, command, parameters):
        """Runs a command of the DevTools protocol."""
        return self._call(
            "POST", f"{self._session}/goog/cdp/execute", {"cmd": command, "params": parameters}
        )

    def press(self, key):
        """Presses and releases a key, as a person would."""
        sequence = {"type": "key", "id": "keys", "actions": [{"type": "keyDown", "value": key}, {"type": "keyUp", "value": key}]}
        self._call("POST", f"{self._session}/actions", {"actions": [sequence]})

    def drag(self, start, end):
        """Drags the mouse from one point of the window to another; points are (x, y)."""
        moves = [
            {"type": "pointerMove", "duration": 0, "x": int(start[0]), "y": int(start[1])},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerMove", "duration": 100, "x": int(end[0]), "y": int(end[1])},
            {"type": "pointerUp", "button": 0},
        ]
        sequence = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": moves}
        self._call("POST", f"{self._session}/actions", {"actions": [sequence]})

    def log(self, kind):
        """Takes the entries of the log `browser` (the console) or `performance` (DevTools events) since the last call."""
        return self._call("POST", f"{self._session}/se/log", {"type": kind})

    def screenshot(self, clip=None):
        """PNG bytes of the window, or of clip = {x, y, width, height} in its pixels."""
        parameters = {"format": "png"}
        if clip:
            parameters["clip"] = {**clip, "scale": 1}
        return base64.b64decode(self.devtools("Page.captureScreenshot", parameters)["data"])
