# SPDX-License-Identifier: GPL-3.0-or-later
"""A live session without a device: its start, its end, and the warnings of its monitor."""

import pickle
import socket
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from gnuradio.wiforce.blocks.frame_alignment import FrameSearch
from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.readings import GroupCounts
from gnuradio.wiforce.planning.findings import Finding
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.waveform import sounding_waveform
from live_runs import scene_file
from wiforce_app.live import monitor as session_monitor
from wiforce_app.live.run import Ending
from wiforce_app.live.session import LiveSession
from wiforce_app.radio.request import RadioRequest

SILENCES = {"leg": "leg is not received"}
HEALTH = SimpleNamespace(state=("waiting", ""), report=dict, silences=SILENCES)


class Watched:
    """A monitor with a clock of its own, and the session of which a test says what it counts."""

    def __init__(self, capsys):
        counts = ("gaps", "samples_lost", "frames_moved", "times_ignored")
        self.session = SimpleNamespace(
            fold=SimpleNamespace(**{name: lambda: 0 for name in counts}),
            time_s=1.0,
            recording_failure=None,
            alignment=SimpleNamespace(searches=0, offset=0),
            start_s=None,
            reader=SimpleNamespace(counts=GroupCounts(), findings=None, groups=SimpleNamespace()),
            clock_offsets_ppm={},
        )
        self._capsys, self._now_s = capsys, 0.0
        self.monitor = session_monitor.SessionMonitor(self.session, HEALTH, now=lambda: self._now_s)

    def count(self, **counts):
        """Let the session have counted so much."""
        for name, count in counts.items():
            setattr(self.session.fold, name, lambda count=count: count)

    def said(self):
        """Lines since the last call."""
        return self._capsys.readouterr().err.splitlines()

    def look(self):
        """Lines of a look at the session that comes when warnings are due again."""
        self._now_s += 1.1
        self.monitor.look()
        return self.said()


@pytest.fixture
def watched(capsys):
    return Watched(capsys)


def test_session_monitor_timing_shift_warns_of_times_and_claims_no_loss(watched):
    cases = (
        (1, 0, ["frame timing shifted once; times may be off by a multiple of the frame length"]),
        (3, 1, ["frame timing shifted 2 times; times", "ignored 1 implausible rx_time tag"]),
        (3, 1, []),
    )
    for moved, ignored, warned in cases:
        watched.count(frames_moved=moved, times_ignored=ignored)
        lines = watched.look()
        assert all(words in line for words, line in zip(warned, lines, strict=True))
        assert not any("lost" in line for line in lines)
    summary, status = watched.monitor.summary(), watched.monitor.status()
    assert "frame timing shifted 3 times" in summary
    assert "\n" not in summary and "lost" not in summary
    assert (status["frames_moved"], status["times_ignored"]) == (3, 1)


def test_session_monitor_warns_at_the_end_of_what_the_last_warnings_did_not_know(watched):
    warn = watched.session.reader.groups.on_warning
    warn("reader: arm: all readings are weak")
    warn("reader: leg is not received")  # said by another already
    watched.monitor.look()
    assert not watched.said()
    watched.monitor.finish()
    assert watched.said() == ["gr-wiforce: warning: reader: arm: all readings are weak"]
    watched.session.time_s = 0.0
    warn("reader: the stream has ended")
    watched.monitor.finish()
    assert not watched.said()


def test_session_monitor_says_once_why_there_are_no_frames(watched):
    """A wrong sample rate was blamed on the antennas."""
    search = watched.session.alignment = FrameSearch(sounding_waveform(), search_frames=8)
    lines = []
    for _ in range(20):
        search.take(np.zeros((search.wanted, 2), np.int16), [])
        lines += watched.look()
    (line,) = lines
    assert "no sounding frames found: all samples are 0" in line and "--rx-gain" in line


def test_session_monitor_many_gaps_advises_larger_socket_buffers(watched):
    for gaps, lost, warned in ((1, 100, False), (7, 600, True)):
        watched.count(gaps=gaps, samples_lost=100 * gaps)
        (line,) = watched.look()
        assert f"{lost} samples lost" in line and ("net.core.rmem_max" in line) is warned


def test_session_monitor_reports_what_the_survey_of_the_room_finds_once(watched):
    """An unlisted tag would stay unsaid."""
    assert watched.monitor.status()["room"] is None
    lines = []
    for frequency_hz in (670.1, 670.2):
        watched.session.reader.findings = [
            Finding("tag", frequency_hz, -5.0, "a tag", "solved for", True),
            Finding("line", 90.0, -30.0, "", "none", False),
        ]
        lines += watched.look()
    (line,) = lines
    assert line.startswith("gr-wiforce: room: tag with a clock of 670")
    assert [each["frequency_hz"] for each in watched.monitor.status()["room"]] == [670.2, 90.0]


def test_symbol_from_a_file_is_part_of_the_request(tmp_path):
    """The process that has the device must be given the symbol, not only its name."""
    n = np.arange(96)
    np.save(tmp_path / "own.npy", np.exp(2j * np.pi * (n**2 / 192 - n / 2)))
    sounding = {"waveform": "own.npy", "frame_length": 400, "repetitions": 3}
    scene = load_scene(scene_file(tmp_path, [], 700, 0.4, sounding=sounding))
    sent = pickle.dumps(RadioRequest.of_scene(scene, "addr=1"))
    (tmp_path / "own.npy").unlink()
    frame = pickle.loads(sent).frames["waveform"].frame()
    assert np.array_equal(frame, scene.waveform().frame()) and np.count_nonzero(frame) == 288


def test_session_counts_no_samples_until_its_flowgraph_runs():
    """The heartbeat's thread read counts that GNU Radio replaced meanwhile, and crashed."""
    scene = load_scene("demo")
    session = LiveSession(scene, RadioRequest.of_scene(scene, "played"), lambda reading: None)
    asked, seen = [], []

    def count(_):
        asked.append(True)
        return 7

    session.source = SimpleNamespace(nitems_written=count, attach=lambda stream, aligned: None)

    def start():
        seen.append((session.samples, session.behind_s))

    session._flowgraph = SimpleNamespace(start=start)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        session.attach(SimpleNamespace(take_samples=lambda: ours, aligned=False))
    assert seen == [(0, 0.0)] and not asked
    assert session.samples == 7


def test_ending_names_the_exception_with_python_3_10(monkeypatch):
    """``sys.exception`` is of Python 3.11: with 3.10, every run ended with an AttributeError."""
    monkeypatch.delattr(sys, "exception", raising=False)
    ending = Ending()
    ending.request("request")
    assert ending.report() == {"state": "ended", "reason": "request", "exit_status": 0}
    try:
        raise OutputError("press.csv", "cannot be written (disk full)")
    except OutputError:
        report = ending.report()
    assert report["reason"] == "press.csv: cannot be written (disk full)"
    assert report["exit_status"] == 1
