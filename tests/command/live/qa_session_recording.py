# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording of a live session reads as the session did, also over a reconnection."""

import socket
import threading

import numpy as np
import pytest
from gnuradio.wiforce.blocks.sample_streams import ResumedTime, SampleTag, pack_head
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.scene import load_scene
from machine import wait_until
from press_capture import FRAME, GROUP, RATE_HZ, SCENE, as_floats, press_codes
from wiforce_app.live.session import LiveSession
from wiforce_app.radio.request import RadioRequest
from wiforce_app.read.recordings import read_capture

PACKET = 4000  # samples
LOST = 9 * GROUP + 100 * FRAME  # when the device is
FOUND = LOST + 600 * FRAME  # again; it has another carrier at first
TUNED = FOUND + 200 * FRAME + 77


class Link:
    """A device that sends codes (n, 2), with the carriers that it has from some samples on."""

    hardware, settings, aligned, clock = "played", {}, False, None

    def __init__(self, codes, carriers):
        self._samples, self._theirs = socket.socketpair()
        self._codes, self._carriers = codes, carriers

    def take_samples(self):
        threading.Thread(target=self._send).start()
        return self._samples

    def _send(self):
        with self._theirs:
            for start in range(0, len(self._codes), PACKET):
                tags = [SampleTag("rx_time", 0, 5, 0.25)] if start == 0 else []
                tags += [
                    SampleTag("rx_freq", at - start, 0, hertz)
                    for at, hertz in self._carriers.items()
                    if start <= at < start + PACKET
                ]
                part = self._codes[start : start + PACKET]
                self._theirs.sendall(pack_head(len(part), tags) + part.tobytes())


def turned(codes, angle):
    """Codes of an oscillator with another phase."""
    samples = 32768 * as_floats(codes) * np.exp(1j * angle)
    return np.rint(samples.astype(np.complex64).view(np.float32)).astype("<i2").reshape(-1, 2)


@pytest.fixture
def session(tmp_path):
    """A session of the usual scene that is recorded, and the list of its readings."""
    scene, readings = load_scene(SCENE), []
    request = RadioRequest.of_scene(scene, "played")
    session = LiveSession(scene, request, readings.append, recording=tmp_path / "run")
    return session, readings


def test_device_lost_before_its_frames_were_found_leaves_no_doubt(session, tmp_path):
    """All readings were flagged moved until a tare, though nothing had been read before."""
    session, live = session
    noise = np.random.default_rng(1).integers(-900, 900, (GROUP, 2)).astype("<i2")
    codes = press_codes(tmp_path)
    session.attach(Link(noise, {}))
    wait_until(lambda: session.source.received == len(noise))
    session.attach(Link(codes, {}))
    wait_until(lambda: session.source.received == len(noise) + len(codes))
    session.stop()
    assert len(live) > 20 and not any("moved" in reading.flags for reading in live)
    assert not any(segment.retuned for segment in open_capture(tmp_path / "run").segments)


def test_recording_of_a_reconnection_reads_as_the_session_did(session, tmp_path):
    """The device's new phases were read as presses of nobody, and noise of another carrier as the
    sensor's."""
    (session, live), codes, now_s = session, press_codes(tmp_path), [0.0]
    session.source.times = ResumedTime(RATE_HZ, FRAME, now=lambda: now_s[0])
    session.attach(Link(codes[:LOST], {0: 900.0002e6}))
    wait_until(lambda: session.source.received == LOST)
    now_s[0] = (FOUND - LOST) / RATE_HZ
    again = turned(codes[FOUND:], 1.2)
    again[: TUNED - FOUND] = np.random.default_rng(1).integers(-900, 900, (TUNED - FOUND, 2))
    session.attach(Link(again, {0: 915e6, TUNED - FOUND: 900.0002e6}))
    wait_until(lambda: session.source.received == LOST + len(again))
    session.stop()
    capture = open_capture(tmp_path / "run")
    assert capture.center_frequency_hz == 900.0002e6
    assert [segment.retuned for segment in capture.segments] == [False, True]
    read = list(read_capture(capture, load_scene(SCENE)))
    assert len(read) == len(live) > 20
    for ours, theirs in zip(read, live, strict=True):
        assert (ours.time_s, ours.touch, ours.flags) == (theirs.time_s, theirs.touch, theirs.flags)
        phases = (theirs.phase1_deg, theirs.phase2_deg)
        assert (ours.phase1_deg, ours.phase2_deg) == pytest.approx(phases, abs=1e-3)
    moved = ["moved" in reading.flags for reading in live if reading.touch is not None]
    assert moved[-1] and not moved[0]
