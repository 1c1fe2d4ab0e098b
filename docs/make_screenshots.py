#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes the pictures of docs/images that show windows, on a screen of its own (needs xvfb).

    build/run python3 docs/make_screenshots.py [press] [companion] [browser]

press_simulation.png is the running flowgraph with a press set, companion.png Companion with it
open. browser_*.png are the page of `gr-wiforce watch --web` with readings of a simulated capture,
in a headless Chromium. Look at them before they are kept.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
FLOWGRAPH = ROOT / "examples" / "press_simulation.grc"
DISPLAY = ":97"
WIDTH, HEIGHT = 1680, 900
# Of the flowgraph, without menus, tools and the list of blocks: x, y, width, height.
CANVAS = (0, 66, 1420, 660)
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
image.copy(*map(int, sys.argv[2:])).save(sys.argv[1])
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


# At a fifth of the usual rate, because only its readings are shown. The last press is harder than
# the calibration knows.
CAPTURE = {
    "radio": {"sample_rate_hz": 2.5e6},
    "sounding": {"frame_length": 400},
    "phase_group": {"snapshots": 200},
    "sensors": [
        {"name": "left", "model": "line-900mhz-calibrated", "clock_hz": 400},
        {"name": "right", "model": "line-900mhz-calibrated", "clock_hz": 560},
    ],
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 24.0,
        "snr_db": 4,
        "static_clutter_db": 50,
        "tags": [
            {"sensor": "left", "clock_offset_ppm": 40},
            {"sensor": "right", "clock_offset_ppm": -65, "level_db": -3},
        ],
        "presses": [
            {"sensor": sensor, "start_s": start, "rise_s": 0.3, "hold_s": hold}
            | {"force_n": force, "end_force_n": last, "location_mm": location}
            for sensor, start, hold, force, last, location in (
                ("left", 2.0, 3.0, 3.0, 6.0, 33.0),
                ("right", 4.0, 3.5, 5.0, 2.5, 52.0),
                ("left", 8.0, 2.0, 1.5, 2.0, 61.0),
                ("right", 10.0, 3.0, 2.0, 4.0, 24.0),
                ("left", 14.0, 1.5, 8.0, 11.0, 40.0),
                ("left", 18.0, 7.0, 2.5, 4.5, 28.0),
                ("right", 19.0, 2.0, 3.0, 3.5, 66.0),
            )
        ],
    },
}
EIGHT = ("thumb", "index", "middle", "ring", "palm", "wrist", "forearm", "elbow")


def take_browser(home):
    sys.path[:0] = [str(ROOT / "tests" / "helpers")]
    from browser import SIZES, browser
    from gnuradio import wiforce
    from web_pages import publishing, serving
    from wiforce_app.web.sources import ZmqSource

    scene = Path(home) / "capture.yaml"
    scene.write_text(json.dumps(CAPTURE))
    wiforce.simulate(wiforce.load_scene(scene), Path(home) / "capture")
    rows = wiforce.read(Path(home) / "capture").to_dict("records")
    for name, sensors, readings in (
        ("browser", ("left", "right"), rows),
        ("browser_eight", EIGHT, eight_of(rows)),
    ):
        with publishing(sensors=sensors) as reader, browser() as window:
            source = ZmqSource(reader.readings, reader.control)
            with serving(source) as (url, _):
                window.open(url)
                reader.until(partial(window.run, "return page.status.state === 'reading'"))
                for start in range(0, len(readings), 100):
                    reader.publish_rows(readings[start : start + 100])
                    time.sleep(0.02)
                for size in SIZES:
                    window.resize(size)
                    window.wait("return page.newest > 20 && !page.changed")
                    # The last readings again, so that they are not out of date.
                    reader.publish_rows(readings[-len(sensors) :])
                    reader.heartbeat()
                    window.picture(IMAGES / f"{name}_{size}.png")


def eight_of(rows):
    """Readings of two sensors as those of eight, each some seconds later than the one before."""
    made = []
    for number, name in enumerate(EIGHT):
        own = [row for row in rows if row["sensor"] == ("left", "right")[number % 2]]
        before = round(97 * (number // 2))
        untouched = [row for row in own if row["flags"] == "" and row["touch"] == 0]
        times = [row["time_s"] for row in own]
        moved = (untouched * len(own))[:before] + own
        made += [row | {"sensor": name, "time_s": t} for row, t in zip(moved, times, strict=False)]
    return sorted(made, key=lambda row: row["time_s"])


def main():
    wanted = sys.argv[1:] or ["press", "companion", "browser"]
    if "browser" in wanted:
        with tempfile.TemporaryDirectory() as home:
            take_browser(home)
    if wanted == ["browser"]:
        return
    if shutil.which("Xvfb") is None:
        sys.exit("make_screenshots: Xvfb is missing (apt install xvfb)")
    screen = subprocess.Popen(
        ["Xvfb", DISPLAY, "-screen", "0", f"{WIDTH}x{HEIGHT}x24"], stderr=subprocess.DEVNULL
    )
    try:
        with tempfile.TemporaryDirectory() as home:
            time.sleep(1)
            environment = os.environ | {"HOME": home, "DISPLAY": DISPLAY, "QT_QPA_PLATFORM": "xcb"}
            if "press" in wanted:
                take_press(environment, home)
            if "companion" in wanted:
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


def grab_when_drawn(environment, path):
    """An empty screen has one colour, a drawn flowgraph some dozens."""
    end = time.monotonic() + 180
    while time.monotonic() < end:
        time.sleep(3)
        done = subprocess.run(
            [sys.executable, "-c", GRAB, str(path), *map(str, CANVAS)],
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
