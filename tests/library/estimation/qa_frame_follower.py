# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of a transmitter on a sample clock of its own, made here by their Fourier series."""

from functools import lru_cache

import numpy as np
import pmt
import pytest
from gnuradio import gr
from gnuradio.wiforce.blocks.snapshots import free_fold
from gnuradio.wiforce.blocks.stream_watch import time_value
from gnuradio.wiforce.estimation.capture.frame import FrameFollower
from gnuradio.wiforce.signal.waveform import sounding_waveform

LENGTH, FRAMES = 400, 1500
SYMBOL = np.exp(1j * np.pi * np.r_[0, np.arange(1, 32), 0, np.arange(-31, 0)] ** 2 / 64)
SYMBOL[[0, 32]] = 0


@lru_cache
def received(ppm):
    """Samples of two antennas, (n, 4): every frame has a common phase of its own."""
    rng = np.random.default_rng(1)
    frame = np.zeros(LENGTH, complex)
    frame[8:328] = np.tile(np.fft.ifft(SYMBOL), 5)
    spectrum, bins = np.fft.fft(frame), np.fft.fftfreq(LENGTH, 1 / LENGTH)
    period = LENGTH * (1 + 1e-6 * ppm)
    samples = np.zeros((FRAMES * LENGTH, 2), complex)
    for number in range(int(FRAMES * LENGTH / period)):
        first = int(np.ceil(number * period))
        shift = np.exp(2j * np.pi * bins * (first - number * period) / LENGTH)
        part = np.fft.ifft(spectrum * shift) * np.exp(2j * np.pi * rng.random())
        end = min(first + LENGTH, len(samples))
        samples[first:end] = part[: end - first, None] * [1.0, 0.5j]
    noise = rng.normal(0, 3e-4, (2, *samples.shape))
    samples += noise[0] + 1j * noise[1]
    parts = np.stack([samples.real, samples.imag], axis=-1).reshape(len(samples), 4)
    return np.rint(60_000 * parts).astype(np.int16)


def delays(frames):
    """Delay of every frame against the first antenna's symbol, in samples."""
    values = (
        frames.reshape(-1, LENGTH, 4)[:, 64:128, 0]
        + 1j * frames.reshape(-1, LENGTH, 4)[:, 64:128, 1]
    )
    channel = np.fft.fft(values)[:, 1:32] / SYMBOL[1:32]
    return -np.angle(np.sum(channel[:, 1:] * channel[:, :-1].conj(), axis=1)) * 64 / (2 * np.pi)


@pytest.mark.parametrize("ppm", [0, 8, -40])
def test_follower_keeps_frames_of_another_clock_in_place(ppm):
    follower, items = FrameFollower(LENGTH), received(ppm)
    frames = np.concatenate([follower.take(part) for part in np.array_split(items, 53)])
    late = delays(frames)
    assert len(late) > FRAMES - 70 and follower.moved == follower.lost == 0
    assert follower.period / LENGTH - 1 == pytest.approx(1e-6 * ppm, abs=2e-6)
    assert np.abs(late - late[0]).max() < 4  # while the period is learned
    assert np.abs(late[900:] - late[0]).max() < 1.6


def test_follower_after_a_known_gap_goes_on_with_the_next_whole_frame():
    follower, items = FrameFollower(LENGTH), received(-40)
    start, lost = 1000 * LENGTH + 123, 5 * LENGTH + 77
    parts = [follower.take(items[:start]), follower.lose(lost, 4)]
    before = sum(map(len, parts)) // LENGTH
    parts.append(follower.take(items[start + lost :]))
    late = delays(np.concatenate(parts))
    assert before == 1000 and follower.lost == 6 and follower.moved == 0
    assert np.abs(late[900:] - late[0]).max() < 1.5


def test_follower_finds_frames_after_an_unknown_loss():
    follower, items = FrameFollower(LENGTH), received(8)
    items = np.concatenate([items[: 500 * LENGTH + 99], items[500 * LENGTH + 99 + 577 :]])
    late = delays(follower.take(items))
    assert follower.moved >= 1
    assert np.abs(late[:499] - late[0]).max() < 3
    assert np.abs(late[-64:] - late[0]).max() < 1.5


class _Source(gr.sync_block):
    def __init__(self, items, tags=()):
        gr.sync_block.__init__(self, "source", None, [(np.int16, 2)])
        self._items, self._at, self._tags = items, 0, list(tags)

    def work(self, _, outputs):
        count = min(len(outputs[0]), len(self._items) - self._at)
        if count == 0:
            return -1
        outputs[0][:count] = self._items[self._at : self._at + count]
        for item, value in self._tags:
            if self._at <= item < self._at + count:
                self.add_item_tag(0, item, pmt.intern("rx_time"), value)
        self._at += count
        return count


class _Sink(gr.sync_block):
    def __init__(self):
        gr.sync_block.__init__(self, "sink", [(np.complex64, 64)], None)
        self.vectors, self.tags = [], []

    def work(self, inputs, _):
        self.vectors.append(inputs[0].copy())
        self.tags += [
            (tag.offset, pmt.symbol_to_string(tag.key), tag.value)
            for tag in self.get_tags_in_window(0, 0, len(inputs[0]))
        ]
        return len(inputs[0])


def test_free_fold_vectors_of_both_antennas_have_one_phase_and_indices_over_gaps():
    items, start, lost = received(8), 700 * LENGTH + 50, 3 * LENGTH
    items = np.concatenate([items[:start], items[start + lost :]])
    times = [(0, time_value(3, 0.0)), (start, time_value(3, (start + lost) / 2.5e6))]
    fold, sinks = free_fold(sounding_waveform("repeated", LENGTH, 2.5e6)), [_Sink(), _Sink()]
    sources = [_Source(items[:, :2].copy(), times), _Source(items[:, 2:].copy())]
    flowgraph = gr.top_block()
    for port in range(2):
        flowgraph.connect(sources[port], (fold, port))
        flowgraph.connect((fold, port), sinks[port])
    flowgraph.run()
    first, second = (np.fft.fft(np.concatenate(sink.vectors))[:, 1:32] for sink in sinks)
    assert len(first) > FRAMES - 80
    ratio = second / first
    assert np.abs(ratio - 0.5j).max() < 0.02
    found = {at: pmt.to_uint64(value) for at, key, value in sinks[0].tags if key == "snapshot"}
    assert found == {0: 0, 700: 704}
    assert (fold.gaps(), fold.samples_lost(), fold.frames_moved()) == (1, lost, 0)
    noise = [value for _, key, value in sinks[1].tags if key == "noise"]
    assert sum(pmt.length(value) for value in noise) == 2 * len(second)
