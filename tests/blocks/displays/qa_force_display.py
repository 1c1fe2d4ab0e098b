# SPDX-License-Identifier: GPL-3.0-or-later
"""The force display, offscreen: readings must be seen, and none of them may end it."""

import math
import sys

import numpy as np
import pmt
import pytest
from chain_runs import PRESSED, Collector
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.gui import style, widget
from gnuradio.wiforce.io.readings import Reading
from press_capture import SLOW, array_source, press_codes, running
from PyQt5 import QtWidgets

# pyqtgraph warns of what goes wrong while it draws, and goes on.
pytestmark = pytest.mark.filterwarnings("error:Ignored exception:RuntimeWarning")


@pytest.fixture
def display(qt, monkeypatch):
    """A display that is shown and redraws on request, not by its timer."""
    raised = []
    # An exception while Qt draws goes no further than this hook.
    monkeypatch.setattr(sys, "excepthook", lambda *error: raised.append(error))
    shown = wiforce.ForceDisplay()
    shown._timer.stop()
    shown.resize(640, 520)
    shown.show()
    yield shown
    shown.close()
    shown.deleteLater()
    qt.processEvents()
    assert raised == []


def picture(display, qt, *readings):
    """The pixels after these readings."""
    for reading in readings:
        display.add(reading)
    for _ in range(widget._HISTORY_EVERY):
        display.refresh()
    qt.processEvents()
    return display.grab().toImage()


def test_reading_as_text_has_two_standard_deviations_units_and_flags():
    reading = Reading(**PRESSED | {"flags": ()})
    assert reading.press() == "4.00 +- 0.20 N at 40.00 +- 1.00 mm"
    assert Reading(1.0, "arm").press() == "touch unknown"
    assert Reading(1.0, "arm", touch=0).press() == "untouched"
    lost = Reading(1.0, "arm", touch=1, location_mm=30.0, flags=("force-unobservable",))
    assert lost.press() == "unknown N at 30.00 mm"
    assert style.warning_flags(lost) == ["force-unobservable"]
    assert style.warning_flags(Reading(1.0, "arm", touch=0, flags=("reference",))) == []


ODD_VALUES = [None, math.nan, math.inf, -math.inf, -3.0, 1e9, "4", True, []]


def test_display_malformed_messages_and_absurd_values_are_tolerated(display, qt):
    picture(display, qt, {}, None, 3, "reading", {"sensor": "arm"}, {"time_s": 1.0})
    assert display.sensors() == []
    for key in PRESSED.keys() - {"flags"}:
        for value in ODD_VALUES:
            display.add(PRESSED | {key: value})
        picture(display, qt, {k: v for k, v in PRESSED.items() if k != key})
    picture(display, qt, PRESSED)
    assert display.latest("arm").force_n == 4.0


def test_display_silent_sensor_turns_grey_and_is_removed(display, qt, monkeypatch):
    clock = {"now": 0.0}
    monkeypatch.setattr(widget.time, "monotonic", lambda: clock["now"])
    other = PRESSED | {"sensor": "finger", "location_mm": 70.0}
    live = picture(display, qt, PRESSED, other)
    clock["now"] = 2.0
    stale = picture(display, qt, PRESSED)
    assert stale != live
    assert display.sensors() == ["arm", "finger"]
    clock["now"] = 11.5
    picture(display, qt, PRESSED)
    assert display.sensors() == ["arm"]
    picture(display, qt, PRESSED, other)
    assert display.sensors() == ["arm", "finger"]
    colors = {track.color for track in display._tracks.values()}
    assert len(colors) == 2


def test_track_keeps_the_span_of_one_run_and_its_gaps():
    kept = widget.Track(2.0)
    kept.add(Reading(9.0, "arm", touch=1, force_n=9.0))  # of a run before
    for time_s in range(6):
        force_n = None if time_s == 4 else float(time_s)
        flags = ("transition",) if time_s == 3 else ()
        kept.add(Reading(float(time_s), "arm", touch=1, force_n=force_n, flags=flags))
    times, forces = kept.series("force_n")
    assert times.tolist() == [3.0, 4.0, 5.0]
    np.testing.assert_array_equal(forces, [np.nan, np.nan, 5.0])
    np.testing.assert_array_equal(kept.series("force_n", flagged=True)[1], [3.0, np.nan, np.nan])
    # A force that disappears from the plot looks like a lost sensor, not like a release.
    kept = widget.Track(2.0)
    kept.add(Reading(1.0, "arm", touch=0, flags=("reference",)))
    kept.add(Reading(1.1, "arm", flags=("gap",)))
    np.testing.assert_array_equal(kept.series("force_n")[1], [0.0, np.nan])
    np.testing.assert_array_equal(kept.series("location_mm")[1], [np.nan, np.nan])


def test_block_shows_messages_and_sends_tare(qt):
    flowgraph = gr.top_block()
    source = blocks.message_strobe(pmt.to_pmt(PRESSED), 5)
    block = wiforce.force_display()
    block.widget._timer.stop()
    collector = Collector()
    flowgraph.msg_connect(source, "strobe", block, "readings")
    flowgraph.msg_connect(block, "tare", collector, "readings")
    refused = pmt.to_pmt({"state": "refused", "reason": "arm is touched"})
    states = blocks.message_strobe(refused, 5)
    flowgraph.msg_connect(states, "strobe", block, "tare_state")
    with running(flowgraph):
        while not (block.widget.sensors() and block.widget._outcome.toolTip()):
            block.widget.refresh()
        block.widget._tare.click()
        collector.wait_for(bool)
    assert block.widget.latest("arm").location_mm == 40.0
    assert len(collector.readings) == 1
    assert block.widget._outcome.toolTip() == "tare refused: arm is touched"
    assert isinstance(block.widget, QtWidgets.QWidget)


def test_block_whose_recording_has_ended_keeps_and_counts_all_readings(qt, tmp_path):
    """The window went empty ten seconds after the end, and nobody saw that it was the end."""
    simulated = {"truth_model": "line-900mhz", "duration_s": 0.3}
    scene = SLOW | {"reference_s": 0.1, "simulation": simulated}
    samples = array_source(press_codes(tmp_path, scene))
    flowgraph, reader = gr.top_block(), wiforce.reader(scene, input_type="sc16")
    block = wiforce.force_display()
    block.widget._timer.stop()
    flowgraph.connect(samples, reader)
    flowgraph.msg_connect(reader, "readings", block, "readings")
    flowgraph.run()
    block.widget.refresh()
    read = reader.counts.clear + reader.counts.flagged
    assert read == 8 and block.widget._time.text() == f"recording ended, {read} readings"
    block.widget._tracks["arm"].seen_s -= 60
    block.widget.refresh()
    assert block.widget.sensors() == ["arm"] and not block.widget._tracks["arm"].view._stale
    assert block.start() and block.widget._time.text()
    block.widget.refresh()
    assert "recording ended" not in block.widget._time.text()


def test_display_tare_button_shows_what_becomes_of_the_request(qt):
    """A user must see that a press or a refusal left the former reference in use."""
    display = wiforce.ForceDisplay()
    reason = "arm was touched at 3.10 s"
    for state, enabled, outcome in (
        ({"state": "measuring"}, False, ""),
        ({"state": "failed", "reason": reason, "forced": False}, True, f"tare failed: {reason}"),
        ({"state": "complete", "reason": "", "forced": True}, True, "tare complete (forced)"),
    ):
        display.show_tare(state)
        display.refresh()
        assert display._tare.isEnabled() == enabled and outcome in display._outcome.toolTip()


def test_trend_block_shows_all_items_of_all_streams(qt):
    block = wiforce.trend_display(labels=["a", "b"], rate=1000.0, history_s=0.4)
    flowgraph = gr.top_block()
    sources = [blocks.vector_source_f(np.arange(n, n + 500.0)) for n in (0, 7)]
    for n, source in enumerate(sources):
        flowgraph.connect(source, (block, n))
    flowgraph.run()
    for n, first in enumerate((0, 7)):
        times, values = block.widget.series(n)
        np.testing.assert_array_equal(values, np.arange(first + 99, first + 500.0))
        np.testing.assert_allclose(times, np.arange(99, 500) / 1000.0)
