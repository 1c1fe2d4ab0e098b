# SPDX-License-Identifier: GPL-3.0-or-later
"""A headless Chromium that opens the page of readings, for tests and for the pictures of docs/."""

import json
import re
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

from machine import wait_until
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

# Of a laptop and of a phone, in CSS pixels.
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}
# Chromium itself must not look for updates either.
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--hide-scrollbars",
)
_LOCAL = re.compile(r"(https?|wss?)://(127\.[0-9.]+|localhost|\[::1\])(:\d+)?(/|$)")
_OWN = re.compile("data:|blob:|about:|chrome:")


class Browser:
    """One window."""

    def __init__(self, driver):
        self.driver = driver
        self._requests = []

    def resize(self, size, height=None):
        """Make the window that of a device of `SIZES`, or higher."""
        width, lowest = SIZES[size]
        metrics = {"width": width, "height": height or lowest, "deviceScaleFactor": 1}
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {**metrics, "mobile": size == "phone"}
        )

    def open(self, url):
        """Open a page, and wait until it has taken a message."""
        self.driver.get(url)
        self.wait("return typeof page !== 'undefined' && page.messages > 0")

    def run(self, script, *arguments):
        """What a script returns."""
        return self.driver.execute_script(script, *arguments)

    def text(self, selector):
        """Text of the first element that a CSS selector finds."""
        return self.run("return document.querySelector(arguments[0])?.textContent", selector)

    def wait(self, script):
        """Wait until a script returns something true; returns it."""
        return wait_until(lambda: self.run(script), 60, 0.03)

    def errors(self):
        """Lines of the console that are warnings or errors."""
        lines = self.driver.get_log("browser")
        return [line["message"] for line in lines if line["level"] in ("WARNING", "SEVERE")]

    def requests(self):
        """Addresses of all requests and sockets so far."""
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                self._requests.append(message["params"]["request"]["url"])
            elif message["method"] == "Network.webSocketCreated":
                self._requests.append(message["params"]["url"])
        return self._requests

    def foreign_requests(self):
        """Those that leave this machine."""
        return [url for url in self.requests() if not (_LOCAL.match(url) or _OWN.match(url))]

    def picture(self, path):
        """Save the page in its whole height, at its present width."""
        size = next(n for n, (width, _) in SIZES.items() if width == self.run("return innerWidth"))
        height = self.run("return document.documentElement.scrollHeight")
        self.resize(size, max(height, SIZES[size][1]))
        time.sleep(0.5)  # for the next drawing
        self.driver.save_screenshot(str(path))
        self.resize(size)


@contextmanager
def browser():
    """A new Chromium without a past."""
    options = Options()
    with tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True) as folder:
        for flag in (*FLAGS, f"--user-data-dir={folder}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        driver = webdriver.Chrome(service=Service(_driver()), options=options)
        try:
            window = Browser(driver)
            window.resize("desktop")
            yield window
        finally:
            driver.quit()


def _driver():
    return next(str(p) for p in map(Path, ("/usr/bin/chromedriver", "chromedriver")) if p.exists())
