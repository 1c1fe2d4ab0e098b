# SPDX-License-Identifier: GPL-3.0-or-later
"""What the page shows, in a headless Chromium, as wide as on a desktop and on a phone."""

import math
import time
from contextlib import contextmanager

import pytest
from gnuradio.wiforce.io.files.writers import open_writer
from web_pages import publishing, serving, touched, untouched
from wiforce_app.web import sources
from wiforce_app.web.sources import FileSource, ZmqSource

pytest.importorskip("selenium")
from browser import browser

EIGHT = ["arm", "leg", "gripper_left_finger_of_the_second_robot", *"abcde"]
# Read at once, since a reading is shown for a second only.
TEXTS = """(() => {
    const text = (selector) => document.querySelector(selector)?.textContent;
    const arm = ["force", "location", "flags", "details"].map(
        (name) => [name, text(`[data-sensor=arm] .${name}`)]);
    return {...Object.fromEntries(arm),
            doubtful: document.querySelector(".doubtful[data-sensor=arm]") !== null};
})()"""
SERIES = """return Object.fromEntries(["lines", "bands", "points"].map(
    (kind) => [kind, page.plots.models(arguments[0] + "-" + kind).data]))"""
MARKS = "return page.plots.models('strip-marks').data"
AXIS = "const range = page.plots.models(arguments[0] + '-range'); return [range.start, range.end]"


@pytest.fixture(scope="module")
def chromium():
    with browser() as window:
        yield window


@pytest.fixture
def window(chromium):
    """The browser; whatever it did, it had nothing to complain of and stayed on this machine."""
    yield chromium
    assert chromium.errors() == []
    requests = chromium.requests()
    assert any("/bokeh.min.js" in url for url in requests)
    assert any(url.startswith("ws://127.0.0.1") for url in requests)
    assert chromium.foreign_requests() == []
    chromium.resize("desktop")


@pytest.fixture
def reader():
    with publishing(sensors=EIGHT) as publisher:
        yield publisher


@contextmanager
def opened(window, source, reader):
    """The page, once the reader reads; left before its server ends."""
    with serving(source) as (url, _):
        window.driver.get(url)
        window.wait("return typeof page !== 'undefined' && !!page.plots?.models")
        reader.until(lambda: window.run("return page.status.state === 'reading'"))
        yield
        window.driver.get("about:blank")


def shown(window, **forces):
    """Wait until sensors' forces are shown as texts; numbers change five times per second."""
    found = [
        f"document.querySelector('[data-sensor={sensor}] .force')?.textContent === '{text}'"
        for sensor, text in forces.items()
    ]
    return window.wait(f"return {' && '.join(found)} && {TEXTS}")


def drawn(window):
    """Wait until the plots show all that has arrived."""
    window.wait("return !page.changed")


def test_page_shows_what_was_published(window, reader):
    """Values, flags and states of the page are those of the reader."""
    with opened(window, ZmqSource(reader.readings, reader.control), reader):
        past = [untouched(0.1 * step) for step in range(1, 10)]
        press = [touched(1.0, 30.0, flags=("transition",), stds=(40.0, 5.0))]
        press += [touched(1.0 + 0.1 * step, 3.0 + 0.1 * step) for step in range(1, 6)]
        doubtful = touched(1.6, 70.0, 44.0, flags=("weak", "inconsistent"))
        reader.publish(*past, *press, doubtful, touched(1.7, 3.456, 41.23))
        texts = shown(window, arm="3.46 ± 0.10 N")
        assert texts["location"] == "41.2 ± 0.4 mm"
        assert texts["flags"] == "" and window.text("#scene") == "scene hand"
        assert texts["details"].startswith("SNR 12.3 dBclock +40.1 ppminterference 25 %")
        drawn(window)
        # Good readings are lines; flagged ones are marks in a strip, whatever they say.
        force = window.run(SERIES, "force")
        assert force["lines"]["ys"] == [[0] * 9, pytest.approx([3.1, 3.2, 3.3, 3.4, 3.5])]
        assert force["points"]["y"] == [3.456]
        assert window.run(MARKS)["x"] == [1.0, 1.6]
        assert window.run(AXIS, "force")[1] == pytest.approx(1.04 * 1.15 * 3.5)
        location = window.run(SERIES, "location")
        assert location["lines"]["ys"] == [[40.0] * 5]
        assert len(location["bands"]["xs"][0]) == 10
        # A doubtful reading says so, and an untouched sensor carries no force.
        reader.publish(touched(1.8, flags=("weak",)), untouched(1.8, "leg"))
        texts = shown(window, arm="3.00 ± 0.10 N", leg="0 N")
        assert texts["flags"] == "weak" and texts["doubtful"]
        # Another run begins with an empty history.
        reader.publish(untouched(0.5), run="another")
        window.wait("return page.newest === 0.5")
        reader.until(lambda: window.text("#run") == "run another", run="another")


def test_page_says_why_a_tare_is_refused_and_that_the_run_has_ended(window, reader, monkeypatch):

    def press_tare():
        reader.until(lambda: window.run("return !byId('tare').disabled"))
        window.run("byId('tare').click()")

    with opened(window, ZmqSource(reader.readings, reader.control), reader):
        reader.refusal = "arm is touched (3.00 N at 40.0 mm)"
        press_tare()
        reader.until(lambda: window.text("#outcome") == f"tare refused: {reader.refusal}")
        assert window.run("return byId('outcome').className") == "bad"
        # Who knows better is asked first.
        assert window.text("#refusal") == f"tare refused: {reader.refusal}"
        window.run("document.querySelector('dialog [value=cancel]').click()")
        assert not window.run("return byId('force').open") and reader.forced == 0
        press_tare()
        window.wait("return byId('force').open")
        window.run("byId('forced').click()")
        reader.until(lambda: window.text("#outcome") == "tare complete")
        assert reader.forced == 1 and not window.run("return byId('force').open")
        reader.refusal = ""
        press_tare()
        reader.until(lambda: window.text("#outcome") == "tare complete")
        # A page that has no connection says so, and connects again.
        window.run("window.kept = connect; window.connect = () => {}; page.socket.close()")
        window.wait("return !byId('connection').hidden")
        assert window.text("#state") == "disconnected"
        window.run("window.connect = kept; connect()")
        reader.until(lambda: window.text("#state") == "reading")
        assert window.run("return byId('connection').hidden")
        monkeypatch.setattr(sources, "_SILENT_S", 0.4)
        # Without a word for four heartbeats the reader counts as lost, and its sensors as silent.
        window.wait("return byId('state').textContent === 'lost'")
        assert "no messages for" in window.text("#reason")
        reader.until(lambda: window.text("#state") == "reading")
        reader.heartbeat("ended", "signal", kind="end")
        window.wait("return byId('state').textContent === 'ended'")
        # The page stays as it was when its server ends with the run.
        window.run("window.connect = () => {}; page.socket.close()")
        window.wait("return !page.connected && page.lostAt !== null")
        time.sleep(0.3)
        assert window.text("#state") == "ended"
        assert window.run("return byId('connection').hidden")


MOVE = """
const box = byId("plots").getBoundingClientRect();
const plot = page.plots.models("force-plot");
const left = box.left + plot.outer_width - 10 - plot.inner_width;
const at = (time) => left + plot.inner_width * (time - page.plots.shown.start)
    / (page.plots.shown.end - page.plots.shown.start);
const send = (kind, time) => byId("plots").dispatchEvent(new PointerEvent(kind,
    { clientX: at(time), clientY: box.top + 60, pointerType: "mouse", bubbles: true }));
"""


def test_page_of_a_finished_file_is_looked_through(window, tmp_path):
    """What happened a minute ago could not be seen any more."""
    path = tmp_path / "readings.csv"
    with open_writer(path) as writer:
        for step in range(1, 1000):
            time_s = 0.1 * step
            pressed = 40 < time_s < 60
            flags = ("weak",) if step == 505 else ()
            writer.write(touched(time_s, 4.0, flags=flags) if pressed else untouched(time_s))
    with serving(FileSource(path), history_s=math.inf) as (url, _):
        window.open(url)
        window.wait("return page.newest > 99.8")
        drawn(window)
        assert window.run("return page.plots.shown") == {"start": pytest.approx(69.9), "end": 99.9}
        window.run(
            "const span = byId('span'); span.value = '';span.dispatchEvent(new Event('change'))"
        )
        window.wait("return page.plots.shown.start < 0.2")
        # A time in the past is looked at, with its numbers.
        window.run(
            "const scrub = byId('scrub'); scrub.value = 50.25;"
            "scrub.dispatchEvent(new Event('input'))"
        )
        shown(window, arm="4.00 ± 0.10 N")
        assert window.text("#cursor") == "at 50.25 s" and window.text("#pause") == "Go on"
        # The values under the pointer, with their flags.
        window.wait("return page.plots.shown.end === 50.25")
        window.run(MOVE + "send('pointermove', 45.0)")
        said = "45.00 s\narm: 4.00 ± 0.10 N, 40.0 ± 0.4 mm"
        assert window.text("#hover") == said
        window.run(MOVE + "send('pointermove', 50.21)")
        # 50.2 s is nearer than the doubtful one at 50.5 s, which lies behind the end.
        assert window.text("#hover").endswith("mm") and window.text("#hover").startswith("50.21 s")
        # A stretch that is dragged over fills the plots, until a double click.
        window.run(MOVE + "send('pointerdown', 42.0); send('pointerup', 48.0)")
        window.wait("return Math.abs(page.plots.shown.start - 42) < 0.2")
        assert window.run("return page.plots.shown.end") == pytest.approx(48, abs=0.2)
        window.run("byId('plots').dispatchEvent(new MouseEvent('dblclick'))")
        window.wait("return page.plots.shown.end === 50.25")
        window.run("byId('pause').click()")
        window.wait("return page.plots.shown.end === 99.9")
        assert window.text("#pause") == "Pause" and window.text("#cursor") == ""
        window.driver.get("about:blank")
