# SPDX-License-Identifier: GPL-3.0-or-later
"""A live session while its flowgraph starts, without a device."""

import socket
import sys
from types import SimpleNamespace

from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.scene import load_scene
from wiforce_app.live.live import _Ending
from wiforce_app.live.session import LiveSession
from wiforce_app.radio.request import RadioRequest


def test_session_counts_no_samples_until_its_flowgraph_runs():
    """The heartbeat's thread read counts that GNU Radio replaced meanwhile, and crashed."""
    scene = load_scene("demo")
    session = LiveSession(scene, RadioRequest.of_scene(scene, "played"), lambda reading: None)
    asked, seen = [], []

    def count(_):
        asked.append(True)
        return 7

    session.source = SimpleNamespace(
        nitems_written=count, received=0, attach=lambda stream, aligned: None
    )

    def start():
        seen.append((session.samples, session.samples_received, session.behind_s))

    session._flowgraph = SimpleNamespace(start=start)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        session.attach(SimpleNamespace(take_samples=lambda: ours, aligned=False))
    assert seen == [(0, 0, 0.0)] and not asked
    assert session.samples == 7


def test_ending_names_the_exception_with_python_3_10(monkeypatch):
    """``sys.exception`` is of Python 3.11: with 3.10, every run ended with an AttributeError."""
    monkeypatch.delattr(sys, "exception", raising=False)
    ending = _Ending()
    ending.request("request")
    assert ending.report() == {"state": "ended", "reason": "request", "exit_status": 0}
    try:
        raise OutputError("press.csv", "cannot be written (disk full)")
    except OutputError:
        report = ending.report()
    assert report["reason"] == "press.csv: cannot be written (disk full)"
    assert report["exit_status"] == 1
