"""A headless Chromium for tests, driven by its own chromedriver (the W3C WebDriver protocol over HTTP)."""

import base64
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import time
import urllib.request
from pathlib import Path

import numpy as np
from PIL import Image

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",  # root may not have one
    "--use-gl=angle",
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PATIENCE = 120.0
"""Seconds that a busy machine may take for anything."""


class Browser:
    """One window; `with Browser(folder) as browser`."""

    def __init__(self, profile: Path):
        self._profile = profile

    def __enter__(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self._process = subprocess.Popen([DRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, start_new_session=True)
        self._address = f"http://127.0.0.1:{port}/session"
        options = {"binary": PROGRAM, "args": [*ARGUMENTS, f"--user-data-dir={self._profile}"]}
        asked = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}
        try:
            _wait_for_port(port)
            self._address += f"/{self._send('POST', '', asked)['sessionId']}"
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(self, *_):
        try:
            self._send("DELETE", "")
        finally:
            self._stop()

    def open(self, address):
        """Show a page anew, also where only what follows its # is another one."""
        self._send("POST", "/url", {"url": "about:blank"})
        self._send("POST", "/url", {"url": address})

    def resize(self, width, height):
        """Give the window a size, as on a phone."""
        self._send("POST", "/window/rect", {"width": width, "height": height})

    def value(self, expression):
        """The JSON value of a JavaScript expression in the page."""
        return self._send("POST", "/execute/sync", {"script": f"return {expression}", "args": []})

    def wait_for(self, expression):
        """Wait until a JavaScript expression is true, and return its value."""
        until = time.monotonic() + PATIENCE
        while not (found := self.value(expression)):
            assert time.monotonic() < until, f"{expression}; the page says: {self.value('document.body.innerText')}"
            time.sleep(0.02)
        return found

    def click(self, selector):
        """Press what a CSS selector finds, as a mouse does."""
        (element,) = self._send("POST", "/element", {"using": "css selector", "value": selector}).values()
        self._send("POST", f"/element/{element}/click", {})

    def drag(self, right, down):
        """Press the mouse in the middle of the window, move it so many pixels, and let go."""
        middle = {"x": self.value("Math.floor(innerWidth / 2)"), "y": self.value("Math.floor(innerHeight / 2)")}
        steps = [
            {"type": "pointerMove", "duration": 0, **middle},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerMove", "duration": 50, "x": middle["x"] + right, "y": middle["y"] + down},
            {"type": "pointerUp", "button": 0},
        ]
        self._send("POST", "/actions", {"actions": [{"type": "pointer", "id": "mouse", "actions": steps}]})

    def picture(self):
        """(H,W,3) in [0, 1]: what the page's canvas shows."""
        data = self.value("document.querySelector('canvas').toDataURL('image/png')").split(",")[1]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")) / 255

    def _stop(self):
        os.killpg(self._process.pid, signal.SIGTERM)  # the browser, too, where the driver could not end it
        self._process.wait()

    def _send(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self._address + path, data, {"Content-Type": "application/json"}, method=method
        )
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            return json.load(answer)["value"]


def _wait_for_port(port):
    until = time.monotonic() + PATIENCE
    while True:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            return
        except ConnectionRefusedError:
            assert time.monotonic() < until, "chromedriver does not answer"
            time.sleep(0.05)
