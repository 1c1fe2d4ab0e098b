# SPDX-License-Identifier: GPL-3.0-or-later
"""A press on a surface in the browser and in Qt: where it is, how hard, and how sure."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.gui.sensor_view import SurfaceView, ellipse
from gnuradio.wiforce.io.readings import SurfaceReading
from gnuradio.wiforce.planning.plan import plan
from web_pages import publishing, serving
from wiforce_app.live.health import geometry
from wiforce_app.web.sources import ZmqSource

pytest.importorskip("selenium")
from browser import browser

# What the page draws of a press, in mm of the plane.
DRAWN = """(() => {
    const card = document.querySelector("[data-sensor=skin]");
    const [plane, dot, spread] = ["rect", ".press", ".spread"].map((s) => card.querySelector(s));
    const number = (node, name) => Number(node.getAttribute(name));
    const mm = number(plane, "width") / 80;
    return {
        strips: card.querySelectorAll("path").length,
        x: (number(dot, "cx") - number(plane, "x")) / mm,
        y: 42 - (number(dot, "cy") - number(plane, "y")) / mm,
        hollow: dot.getAttribute("fill") === "none",
        spread: [number(spread, "rx") / mm, number(spread, "ry") / mm],
        angle: -Number(/rotate\\((.*)\\)/.exec(spread.getAttribute("transform"))[1]),
    };
})()"""


def press(time_s=1.0, force_n=4.0, flags=(), **more):
    values = {"y_mm": 12.0, "y_std_mm": 1.5, "cov_x_y": 1.2} | more
    return SurfaceReading(time_s, "skin", 1, force_n, 0.1, 30.0, 2.0, flags=flags, **values)


def test_page_draws_the_press_where_it_is_with_its_covariance():
    skin = plan("surface_four_strips").skin
    with publishing(sensors=["strip1"]) as reader, browser() as window:
        with serving(ZmqSource(reader.readings, reader.control)) as (url, _):
            window.driver.get(url)
            window.wait("return typeof page !== 'undefined' && !!page.plots?.models")
            shown = "return page.status.state === 'reading' && !!page.status.surface"
            reader.until(lambda: window.run(shown), surface=geometry(skin))

            def drawn(reading):
                reader.publish(reading)
                card = "document.querySelector('[data-sensor=skin]')"
                # The arrow follows every reading, numbers five times per second.
                parts = f"!!{card}.querySelector('.press') && !!{card}.querySelector('.location')"
                shown = f"{card} && {parts} && {card}.querySelector('.location').textContent"
                # In one call, since the page goes on drawing.
                return window.wait(f"return page.newest === {reading.time_s} && {shown} && {DRAWN}")

            clear = drawn(press())
            assert clear["strips"] == 4
            assert (clear["x"], clear["y"]) == pytest.approx((30.0, 12.0), abs=0.01)
            (first, second), angle = ellipse(press())
            assert sorted(clear["spread"]) == pytest.approx(sorted([first, second]), abs=0.01)
            assert (clear["angle"] - angle) % 180 == pytest.approx(90.0, abs=0.1)
            # What is doubtful looks doubtful.
            assert drawn(press(1.1, flags=("inconsistent",)))["hollow"] and not clear["hollow"]
            assert window.errors() == []
            window.driver.get("about:blank")


def test_ellipse_has_the_axes_of_the_covariance():
    (semi, angle), tilt = ellipse(press(cov_x_y=0.0)), 30.0
    assert sorted(semi) == pytest.approx([3.0, 4.0]) and angle % 180 == pytest.approx(90.0)
    turn = np.radians(tilt)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    c = axes @ np.diag([1.0, 9.0]) @ axes.T
    reading = press(y_std_mm=np.sqrt(c[1, 1]), cov_x_y=c[0, 1])
    semi, angle = ellipse(replace(reading, location_std_mm=np.sqrt(c[0, 0])))
    assert semi == pytest.approx((2.0, 6.0)) and angle % 180 == pytest.approx(tilt)
    assert ellipse(press(y_std_mm=None))[0] is None


def test_qt_display_draws_a_surface_from_above(qt):
    display = wiforce.ForceDisplay(strips_y_mm=(0, 12, 24, 36))
    try:
        display._timer.stop()
        display.resize(640, 520)
        display.show()

        def image(reading):
            display.add(reading)
            display.refresh()
            qt.processEvents()
            picture = display.grab().toImage()
            return bytes(picture.bits().asarray(picture.byteCount()))

        low, high = image(press(1.0, y_mm=2.0)), image(press(1.1, y_mm=34.0))
        assert isinstance(display._tracks["skin"].view, SurfaceView)
        assert len({low, high, image(press(1.2, y_mm=34.0, flags=("weak",)))}) == 3
        for strange in (press(1.3, y_mm=1e9), press(1.4, force_n=None), press(1.5, y_mm=None)):
            image(strange)
    finally:
        display.close()
        display.deleteLater()
        qt.processEvents()
