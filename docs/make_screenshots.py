#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes the pictures of docs/images that show windows, on a screen of its own (needs xvfb).

    build/run python3 docs/make_screenshots.py

press_simulation.png is the running flowgraph with a press set, companion.png Companion with it
open. Look at them before they are kept.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
FLOWGRAPH = ROOT / "examples" / "press_simulation.grc"
DISPLAY = ":97"
WIDTH, HEIGHT = 1680, 900
# GRC spells the last one so.
PREFERENCES = f"""[main]
main_window_width = {WIDTH}
main_window_height = {HEIGHT}
blocks_window_position = {WIDTH - 200}
console_window_visible = False
variable_editor_visable = False
"""
GRAB = """
import sys
from PyQt5.QtWidgets import QApplication
application = QApplication(sys.argv)
image = application.primaryScreen().grabWindow(0).toImage()
places = [(x, y) for x in range(0, image.width(), 7) for y in range(0, image.height(), 7)]
colors = {image.pixel(*place) for place in places}
image.save(sys.argv[1])
print(len(colors))
"""
PRESS = """
import sys, time
sys.path.insert(0, sys.argv[1])
from PyQt5.QtWidgets import QApplication
application = QApplication(sys.argv)
from press_simulation import press_simulation
flowgraph = press_simulation()
flowgraph.resize(760, 720)
flowgraph.start()
flowgraph.show()
steps = [(1.5, 3.0, 33.0), (4.0, 5.5, 47.0), (6.5, 0.0, 47.0), (8.0, 4.0, 55.0)]
while True:
    application.processEvents()
    time.sleep(0.01)
    readings = flowgraph.display.widget
    now = readings.latest("arm").time_s if readings.sensors() else 0.0
    if steps and now > steps[0][0]:
        _, force_n, location_mm = steps.pop(0)
        flowgraph._force_n_win.d_widget.counter.setValue(force_n)
        flowgraph._location_mm_win.d_widget.counter.setValue(location_mm)
    if not steps and now > 10.0:
        readings.grab().save(sys.argv[3])
        flowgraph.grab().save(sys.argv[2])
        flowgraph.stop()
        flowgraph.wait()
        break
"""


def main():
    if shutil.which("Xvfb") is None:
        sys.exit("make_screenshots: Xvfb is missing (apt install xvfb)")
    screen = subprocess.Popen(
        ["Xvfb", DISPLAY, "-screen", "0", f"{WIDTH}x{HEIGHT}x24"], stderr=subprocess.DEVNULL
    )
    try:
        with tempfile.TemporaryDirectory() as home:
            time.sleep(1)
            environment = os.environ | {"HOME": home, "DISPLAY": DISPLAY, "QT_QPA_PLATFORM": "xcb"}
            take_press(environment, home)
            take_companion(environment, home)
    finally:
        screen.terminate()
        screen.wait()


def take_press(environment, home):
    subprocess.run(
        ["grcc", "-o", home, str(FLOWGRAPH)],
        env=environment,
        check=True,
        timeout=200,
        stdout=subprocess.DEVNULL,
    )
    pictures = [str(IMAGES / name) for name in ("press_simulation.png", "force_display.png")]
    command = [sys.executable, "-c", PRESS, home, *pictures]
    subprocess.run(command, env=environment, check=True, timeout=200)


def take_companion(environment, home):
    preferences = Path(home) / ".gnuradio" / "grc.conf"
    preferences.parent.mkdir(exist_ok=True)
    preferences.write_text(PREFERENCES)
    companion = subprocess.Popen(
        ["gnuradio-companion", str(FLOWGRAPH)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        grab_when_drawn(environment, IMAGES / "companion.png")
    finally:
        os.killpg(companion.pid, signal.SIGTERM)
        companion.wait()


def grab_when_drawn(environment, path, timeout_s=180):
    """An empty screen has one colour, a drawn flowgraph some dozens."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        time.sleep(3)
        done = subprocess.run(
            [sys.executable, "-c", GRAB, str(path)],
            env=environment,
            capture_output=True,
            text=True,
            timeout=60,
        )
        if done.returncode == 0 and int(done.stdout) > 25:
            return
    sys.exit("make_screenshots: Companion did not draw")


if __name__ == "__main__":
    main()
