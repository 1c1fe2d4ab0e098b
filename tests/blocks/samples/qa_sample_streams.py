# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples from one process to another, and their time when the device is lost and found."""

import itertools
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pmt
import pytest
from device_times import rx_time, tag_at
from gnuradio import blocks, gr
from gnuradio.wiforce.blocks.frame_alignment import FrameSearch, frame_alignment
from gnuradio.wiforce.blocks.sample_streams import (
    SAMPLE_BYTES,
    ResumedTime,
    SampleTag,
    pack_head,
    sample_receiver,
    sample_sender,
    wait_briefly,
)
from gnuradio.wiforce.blocks.stream_watch import Timeline, time_value
from gnuradio.wiforce.estimation.capture.frame import MARGIN
from gnuradio.wiforce.signal.waveform import sounding_waveform
from machine import wait_until
from press_capture import array_source, run_flowgraph, running

RATE, FRAME = 1e6, 400


def codes(count, seed=1):
    return np.random.default_rng(seed).integers(-9000, 9000, (count, 2), np.int16)


def aligned():
    """The search of a stream that begins with a frame."""
    search = FrameSearch(sounding_waveform())
    search.offset = 0
    return search


def received(receiver, feed):
    """Samples and tags that a receiver gives while ``feed()`` runs in another thread."""
    sink, feeding = blocks.vector_sink_s(2), threading.Thread(target=feed)
    feeding.start()
    run_flowgraph(receiver, sink)
    feeding.join()
    found = [(tag.offset, pmt.symbol_to_string(tag.key), tag.value) for tag in sink.tags()]
    return np.array(sink.data(), np.int16).reshape(-1, 2), sorted(found, key=lambda tag: tag[0])


class System:
    """Options of a socket where a timeval has two fields of so many bytes."""

    def __init__(self, size):
        self.held = bytes(2 * size)

    def getsockopt(self, level, option, most):
        return self.held

    def setsockopt(self, level, option, value):
        assert len(value) == len(self.held)
        self.held = value


@pytest.mark.parametrize("size", [4, 8])
def test_wait_of_a_socket_has_the_size_that_the_system_takes(size):
    """On 32-bit ARM with 64-bit times no live run could start."""
    system = System(size)
    wait_briefly(system, socket.SO_RCVTIMEO)
    assert np.frombuffer(system.held, f"i{size}").tolist() == [0, 100_000]


def test_wait_of_a_socket_ends_a_call():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        wait_briefly(ours, socket.SO_RCVTIMEO)
        with pytest.raises(BlockingIOError):
            ours.recv(1)


def fed(receiver, *streams):
    """Samples and tags that a receiver gives of streams, one after the other."""

    def feed():
        for stream in streams:
            ours, theirs = socket.socketpair()
            receiver.attach(ours)
            theirs.sendall(stream)
            theirs.close()
        receiver.finish()

    return received(receiver, feed)


def packet(samples, *tags):
    return pack_head(len(samples), tags) + samples.tobytes()


def test_sender_and_receiver_pass_all_samples_and_tags():
    ours, theirs = socket.socketpair()
    sent = codes(300_000)
    tags = [
        tag_at(0, "rx_time", time_value(7, 0.5)),
        tag_at(0, "rx_freq", pmt.from_double(900e6)),
        tag_at(123_456, "rx_time", time_value(7, 0.75)),
        tag_at(123_456, "packet_len", pmt.from_long(5)),
    ]
    source, sender, receiver = (
        array_source(sent, tags),
        sample_sender(theirs),
        sample_receiver(RATE, FRAME, aligned()),
    )
    receiver.attach(ours)

    def feed():
        run_flowgraph(source, sender)
        theirs.close()
        receiver.finish()

    items, found = received(receiver, feed)
    assert np.array_equal(items, sent) and sender.sent == len(sent)
    assert [(offset, key, pmt.to_python(value)) for offset, key, value in found] == [
        (0, "rx_time", (7, 0.5)),
        (0, "rx_freq", 900e6),
        (123_456, "rx_time", (7, 0.75)),
    ]


@pytest.mark.parametrize("torn_bytes", [11, 4001])
def test_receiver_stream_torn_in_a_packet_keeps_whole_samples_and_reads_the_next(torn_bytes):
    """A driver that crashes may leave any part of a packet behind."""
    receiver = sample_receiver(RATE, FRAME, aligned())
    first, torn, second = codes(1000, 1), codes(1000, 2), codes(900, 3)
    start = SampleTag("rx_time", 0, 3, 0.0)
    cut = packet(first, start) + packet(torn)[:torn_bytes]
    items, found = fed(receiver, cut, packet(second, start))
    whole = max(torn_bytes - len(pack_head(1)), 0) // 4
    assert np.array_equal(items, np.concatenate([first, torn[:whole], second]))
    keys = [(offset, key) for offset, key, _ in found]
    resumed = len(first) + whole
    assert sorted(keys) == [(0, "rx_time"), (resumed, "retuned"), (resumed, "rx_time")]


def test_sender_with_an_interval_sends_together_what_arrives_meanwhile():
    """A packet of its own for each of the device's would cost a core on either side."""
    ours, theirs = socket.socketpair()
    sent = codes(100_000)
    flowgraph, heads = gr.top_block(), []
    source, sender = array_source(sent, packet=1000), sample_sender(theirs, interval_s=0.1)
    flowgraph.connect(source, sender)
    with ours, running(flowgraph):
        data = b""
        while len(data) < sent.nbytes:
            samples, _ = struct.unpack("<II", ours.recv(8, socket.MSG_WAITALL))
            heads.append(samples)
            data += ours.recv(SAMPLE_BYTES * samples, socket.MSG_WAITALL)
    theirs.close()
    assert np.array_equal(np.frombuffer(data, np.int16).reshape(-1, 2), sent)
    assert len(heads) < 20  # of 100 pieces of 1000 samples


def framed(before, frames):
    """Frames of the usual waveform after so many samples without them, as integers."""
    sent = np.concatenate([np.zeros(before), np.tile(0.4 * sounding_waveform().frame(), frames)])
    noise = np.random.default_rng(4).normal(0, 30, (len(sent), 2))
    return np.rint(32768 * sent.astype(complex).view(float).reshape(-1, 2) + noise).astype(np.int16)


def test_receiver_with_a_search_begins_with_the_first_frame_and_its_time():
    rate, before = 12.5e6, 500
    waveform = sounding_waveform()
    search = FrameSearch(waveform, search_frames=20)
    receiver = sample_receiver(rate, waveform.frame_length, search)
    sent = framed(before, 60)
    lost = 50 * waveform.frame_length
    tags = [SampleTag("rx_time", 0, 3, 0.5), SampleTag("rx_freq", 30_000, 0, 900e6)]
    later = SampleTag("rx_time", 0, 3, 0.5 + (40_000 + lost) / rate)
    items, found = fed(receiver, packet(sent[:40_000], *tags) + packet(sent[40_000:], later))
    first = before - MARGIN
    assert search.offset == first and receiver.received == len(sent)
    assert np.array_equal(items, sent[first:])
    assert receiver.peak <= np.abs(sent).max()
    assert sum(search.start_time) == pytest.approx(3.5 + first / rate, abs=1e-9)
    plain = [
        (item, key, value if key == "rx_freq" else sum(value))
        for item, key, value in ((item, key, pmt.to_python(value)) for item, key, value in found)
    ]
    assert plain == [
        (0, "rx_time", pytest.approx(3.5 + first / rate, abs=1e-9)),
        (30_000 - first, "rx_freq", 900e6),
        (40_000 - first, "rx_time", pytest.approx(3.5 + (40_000 + lost) / rate, abs=1e-9)),
    ]


def test_receiver_without_frames_ends_with_its_stream():
    """Frames are searched in one call of the scheduler, which must return for the end of a run."""
    search = FrameSearch(sounding_waveform(), search_frames=20)
    receiver = sample_receiver(12.5e6, 720, search)

    def feed():
        ours, theirs = socket.socketpair()
        receiver.attach(ours)
        theirs.sendall(packet(codes(20_000)))
        receiver.finish()  # before the end of the stream, as when a run is ended
        theirs.sendall(packet(codes(20_000)))
        theirs.close()

    items, _ = received(receiver, feed)
    assert len(items) == 0 and search.searches == 2 and receiver.received == 40_000


def test_receiver_stream_that_hangs_in_a_packet_is_idle_and_not_behind():
    """A driver that hangs must be noticed, and not be mistaken for a blocked output."""
    receiver = sample_receiver(RATE, FRAME, aligned())
    ours, theirs = socket.socketpair()
    receiver.attach(ours)
    noticed = []

    def is_noticed():
        return receiver.idle_s > 0.4 and time.monotonic() - receiver.called_s < 0.35

    def feed():
        theirs.sendall(packet(codes(1000))[:2000])
        with theirs, suppress(AssertionError):
            noticed.append(wait_until(is_noticed, 60))
        receiver.finish()

    received(receiver, feed)
    assert noticed


@pytest.mark.parametrize("start_s", [0, 9, 10, 5000])
def test_resumed_time_continues_whatever_the_next_clock_shows(start_s):
    """A device that has run for longer than the first one would shift all later times."""
    host = itertools.chain([0.0], itertools.repeat(2.0))
    times = ResumedTime(RATE, FRAME, now=lambda: next(host))
    times.begin((7, 0.0))
    assert times.stream_clock == (1, 0.0)
    times.received(1_000_000)
    ((seconds, fraction),) = times.begin((start_s, 0.7))
    assert seconds + fraction == pytest.approx(10.0, abs=FRAME / RATE)
    streams, offset_s = times.stream_clock
    assert streams == 2 and start_s + 0.7 + offset_s == pytest.approx(seconds + fraction)
    assert sum(times.of(2_000_000, (start_s + 1, 0.7))) == pytest.approx(seconds + 1 + fraction)


@pytest.mark.parametrize("hours", [0.5, 1.5, 30])
def test_resumed_time_long_break_is_plausible_to_the_chain(hours):
    """Blocks take a jump of more than an hour for a wrong time."""
    host = itertools.chain([0.0], itertools.repeat(3600.0 * hours))
    times = ResumedTime(RATE, FRAME, now=lambda: next(host))
    chain = Timeline(RATE)
    chain.note(0, *times.begin((100, 0.0))[0])
    times.received(1_000_000)
    steps = times.begin((0, 0.5))
    lost = [chain.note(1_000_000 + item, *value) for item, value in enumerate(steps)]
    assert sum(lost) == pytest.approx(3600 * hours * RATE, abs=FRAME)
    assert all(lost)
    # Device time continues from there.
    assert chain.note(1_500_000, *times.of(1_500_000, (1, 0.0))) == 0


def test_frame_alignment_without_frames_keeps_few_tags():
    """A reader without its transmitter may run for weeks, with a gap now and then."""
    alignment = frame_alignment(frame_length=720, item_type="sc16", search_frames=10)
    count, gaps = 720_000, 1000
    every = count // gaps
    tags = [rx_time(n * every, n) for n in range(gaps)]
    source, sink = array_source(codes(count), tags), blocks.null_sink(4)
    run_flowgraph(source, alignment, sink)
    assert alignment.offset is None and alignment.searches == 0
    assert len(alignment.search.tags) <= 3


def test_uncaught_exception_in_a_blocks_stop_ends_the_process_quietly():
    """UHD's blocks throw when they are stopped without their device, in a destructor."""
    program = (
        "from gnuradio import blocks, gr\n"
        "from gnuradio.wiforce.wiforce_kernels import exit_on_terminate\n"
        "class throwing(gr.sync_block):\n"
        "    def __init__(self):\n"
        "        gr.sync_block.__init__(self, 'throwing', in_sig=['f4'], out_sig=None)\n"
        "    def work(self, items, _):\n"
        "        return len(items[0])\n"
        "    def stop(self):\n"
        "        raise RuntimeError('send error on socket')\n"
        "block, flowgraph = throwing(), gr.top_block()\n"
        "exit_on_terminate(7)\n"
        "flowgraph.connect(blocks.null_source(4), blocks.head(4, 100), block)\n"
        "flowgraph.run()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 7
    assert "terminate" not in done.stderr
