# SPDX-License-Identifier: GPL-3.0-or-later
"""The chains that are compared, and the recording that they read: preambles in noise.

Each makes a function that runs it once, and its tones.
"""

import os
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from gnuradio import blocks, fft, gr, wiforce
from gnuradio.wiforce.blocks.group_block import SnapshotSink
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.wiforce_kernels import tone_reader, tone_transform

# Item types of blocks as SigMF names them, and bytes of a sample.
DATATYPE = {"sc16": "ci16_le", "fc32": "cf32_le"}
_BYTES = {"sc16": 4, "fc32": 8}
GROUP_LENGTH = 625
WAVEFORM = sounding_waveform()
GROUP_SAMPLES = GROUP_LENGTH * WAVEFORM.frame_length
# Of 32768: frames stand 11 dB above the noise, so that their watch is at rest.
FRAME_PEAK, NOISE_PEAK = 18_000, 4_000
# Bursts of another transmitter raise the noise by 8 dB. A group has three, of 5 to 19 frames (0.3
# to 1.1 ms), as packets of Wi-Fi have.
BURST_PEAK, _BURSTS, _BURST_FRAMES = 9_000, 3, (5, 20)
# Different groups, which a recording repeats.
_KINDS = 7
# Harmonic m of a tag at 1 kHz is bin 36 m of a group.
BINS_PER_HARMONIC = 36


def tone_weights(tones):
    """Fourier weights of a tag's lines; (tones, 625). Four tones: +-1 and +-4, else +-1.."""
    harmonics = [1, 4] if tones == 4 else range(1, tones // 2 + 1)
    bins = BINS_PER_HARMONIC * np.array([m for h in harmonics for m in (h, -h)], int)
    n = np.arange(GROUP_LENGTH)
    return np.exp(-2j * np.pi * np.outer(bins, n) / GROUP_LENGTH) / GROUP_LENGTH


@dataclass(frozen=True)
class Recording:
    """The same samples as raw ``cf32_le`` and ``ci16_le``; ``bursts``: in every group."""

    fc32: Path
    sc16: Path
    samples: int
    bursts: bool = False

    @property
    def groups(self):
        return self.samples // GROUP_SAMPLES

    def shortened(self, samples):
        """The recording's first samples, in whole groups."""
        groups = max(1, round(samples / GROUP_SAMPLES))
        return replace(self, samples=groups * GROUP_SAMPLES)


def write_recording(folder, samples, bursts=False):
    """Writes a recording of about so many samples, in whole groups."""
    groups = max(2, samples // GROUP_SAMPLES)
    kinds, _ = _groups(bursts)
    path = Path(folder) / ("bursts" if bursts else "frames")
    files = path.with_suffix(".cf32"), path.with_suffix(".ci16")
    floats = [codes.astype("<f4") / np.float32(32768) for codes in kinds]
    for file, parts in zip(files, (floats, kinds), strict=True):
        with open(file, "wb") as stream:
            for group in range(groups):
                stream.write(parts[group % len(parts)])
        _settle(file)
    return Recording(*files, groups * GROUP_SAMPLES, bursts)


@cache
def _groups(bursts):
    """Codes (_KINDS, 2 GROUP_SAMPLES) of groups, and frames without bursts (_KINDS, 625)."""
    rng = np.random.default_rng(1)
    frame = WAVEFORM.frame()
    codes = (FRAME_PEAK / np.abs(frame).max() * frame).view(float).astype("<i2")
    noise = rng.integers(-NOISE_PEAK, NOISE_PEAK, (_KINDS, 2 * GROUP_SAMPLES), dtype="<i2")
    groups = np.tile(codes, GROUP_LENGTH) + noise
    quiet = np.ones((_KINDS, GROUP_LENGTH), bool)
    for kind in range(_KINDS if bursts else 0):
        frames = groups[kind].reshape(GROUP_LENGTH, -1)
        for _ in range(_BURSTS):
            first = rng.integers(GROUP_LENGTH - _BURST_FRAMES[1])
            hit = slice(first, first + rng.integers(*_BURST_FRAMES))
            if quiet[kind, hit].all():  # two at a time could exceed the codes
                frames[hit] += rng.integers(-BURST_PEAK, BURST_PEAK, frames[hit].shape, "<i2")
                quiet[kind, hit] = False
    return groups, quiet


def _settle(path):
    """Leaves the file in memory as read from disk, whose pages are mapped twice as fast."""
    with open(path, "r+b") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while file.read(1 << 24):
            pass


def reference_tones(recording, weights):
    """Channel (groups, M, 64) of tones, without frames of bursts, in double precision."""
    repetitions = WAVEFORM.repetitions
    first, length = WAVEFORM.first_averaged, 64 * repetitions
    kinds = []
    for codes, quiet in zip(*_groups(recording.bursts), strict=True):
        samples = codes.astype(float).view(complex) / 32768
        frames = samples.reshape(GROUP_LENGTH, -1)[:, first : first + length]
        folded = frames.reshape(GROUP_LENGTH, repetitions, 64).mean(axis=1)
        kinds.append(np.fft.fft(weights * quiet @ folded) * WAVEFORM.equalizer())
    return np.array(kinds)[np.arange(recording.groups) % len(kinds)]


# What a skilled user ends at for the stock chain: samples and vectors per buffer. More or less
# of either is slower.
TUNED_SAMPLES, TUNED_VECTORS = 131072, 128


class Flowgraph:
    """A flowgraph of blocks in a row, which is run once."""

    def __init__(self, *row):
        self.top = gr.top_block("bench", catch_exceptions=False)
        self.row = row  # Python blocks are freed when no name refers to them
        self.sinks = []
        self.top.connect(*row)

    def end(self, *ends):
        """Keep the tones that blocks give, those of the row or behind it: some of all each."""
        for block in ends:
            length = block.output_signature().sizeof_stream_item(0) // gr.sizeof_gr_complex
            self.sinks.append((blocks.vector_sink_c(length), length // 64))
            self.top.connect(block, self.sinks[-1][0])
        return self

    def run(self):
        self.top.run()
        if (failure := getattr(self.row[-1], "failure", None)) is not None:
            raise failure

    @property
    def tones(self):
        """(groups, M, 64), or None of a chain without."""
        if not self.sinks:
            return getattr(self.row[-1], "tones", None)
        parts = [np.array(s.data(), np.complex64).reshape(-1, m, 64) for s, m in self.sinks]
        groups = min(map(len, parts))
        return np.concatenate([part[:groups] for part in parts], axis=1)


class ToneSink(SnapshotSink):
    """Computes tones (M, 64) of complete groups as the Reader does, without reading them."""

    def __init__(self, weights):
        SnapshotSink.__init__(self, "tone_sink", GROUP_LENGTH, WAVEFORM.symbol_length)
        bins = range(WAVEFORM.symbol_length)
        self._kernel = tone_transform(weights, WAVEFORM.equalizer(), np.zeros(0), bins)
        self._tones = []

    def read(self, groups):
        if not all(group.kept is self.everything for group in groups):
            raise ValueError("a group of this stream is complete and without interference")
        self._tones += [self._kernel.transform(group.folded) for group in groups]

    @property
    def tones(self):
        return np.array(self._tones)


def stream(recording, weights, item_type):
    """Folding and tones as the Reader computes them, behind a file source."""
    collected = wiforce.preamble_fold.collected(
        GROUP_LENGTH, WAVEFORM.frame_length, item_type=item_type
    )
    return Flowgraph(_file_source(recording, item_type), collected, ToneSink(weights))


def _file_source(recording, item_type="fc32"):
    path, size = str(getattr(recording, item_type)), _BYTES[item_type]
    return blocks.file_source(size, path, False, 0, recording.samples)


def planned(settings, recording, item_type, order, segments=None, derotated=False):
    """The tones of a plan from a recording, by ``order``; ``recording``: of its segments."""
    waveform, table, rotation = settings.waveform, settings.table, None
    if derotated:
        rotation = table.derotation(waveform.sample_rate_hz, waveform.symbol_length)
    row = kernel_blocks(order, table.weights, settings.group_length, waveform, item_type, rotation)
    source = _file_source(recording, item_type)
    if order == "recording":
        path, datatype = str(getattr(recording, item_type)), DATATYPE[item_type]
        source = wiforce.recording_source(path, datatype, segments, **waveform.folding)
    return Flowgraph(source, *row).end(row[-1])


def kernel_blocks(order, weights, group_length, waveform=WAVEFORM, item_type="fc32", rotation=None):
    """Blocks from samples to the channel at tones of weights (M, group_length).

    ``order``: ``tones first``, ``block by block`` (snapshots between), ``channel first``, or
    ``recording``, whose source folds.
    """
    frame = {**waveform.folding, "item_type": item_type}
    group = {"weights": weights, "group_length": group_length}
    factors = waveform.equalizer().astype(np.complex64)
    fold = [] if order == "recording" else [wiforce.preamble_fold(**frame)]
    if order == "channel first":
        estimator = wiforce.ofdm_channel_estimator(factors, 1)
        return [*fold, estimator, wiforce.phase_group_doppler(**group)]
    rotations = () if rotation is None else (rotation.astype(np.complex64),)
    estimator = wiforce.ofdm_channel_estimator(factors, len(weights), *rotations)
    if order == "tones first":
        return [wiforce.preamble_fold.tones(**group, **frame), estimator]
    return [*fold, wiforce.phase_group_doppler(**group), estimator]


def separate_blocks(recording, weights):
    """Folding and tones in a block each, as a flowgraph that shows the snapshots has it."""
    row = kernel_blocks("block by block", weights, GROUP_LENGTH)
    return Flowgraph(_file_source(recording), *row).end(row[-1])


class RecordedTones:
    """A whole recording read without a flowgraph."""

    def __init__(self, recording, weights, item_type):
        path, datatype = str(getattr(recording, item_type)), DATATYPE[item_type]
        shape = WAVEFORM.frame_length, WAVEFORM.first_averaged, WAVEFORM.repetitions
        length = WAVEFORM.symbol_length
        group = weights, WAVEFORM.equalizer(), [], range(length)
        segments = [(0, 0, recording.samples)]
        self._open = lambda: tone_reader(path, datatype, segments, *shape, 0, length, *group)

    def run(self):
        reader, batches = self._open(), []
        while len(batch := reader.read(_GROUPS_PER_BATCH)["tones"]):
            batches.append(batch)
        self.tones = np.concatenate(batches)


# Larger batches are no faster.
_GROUPS_PER_BATCH = 256


def stock(recording, weights):
    """GNU Radio's own blocks: keep what is averaged, fold, weight a group at once, sum."""
    source = _file_source(recording)
    keep = blocks.keep_m_in_n(8, 64 * WAVEFORM.repetitions, WAVEFORM.frame_length, 64)
    pack = blocks.stream_to_vector(8, 64)
    fold = blocks.integrate_cc(WAVEFORM.repetitions, 64)
    group = blocks.stream_to_vector(8 * 64, GROUP_LENGTH)
    source.set_min_output_buffer(TUNED_SAMPLES)
    keep.set_min_output_buffer(TUNED_SAMPLES // 2)
    pack.set_min_output_buffer(4 * TUNED_VECTORS)
    fold.set_min_output_buffer(TUNED_VECTORS)
    group.set_min_output_buffer(4)
    flowgraph, ends = Flowgraph(source, keep, pack, fold, group), []
    for row in weights / WAVEFORM.repetitions:
        weight = blocks.multiply_const_vcc(np.repeat(row, 64).astype(np.complex64).tolist())
        unpack = blocks.vector_to_stream(8 * 64, GROUP_LENGTH)
        weight.set_min_output_buffer(4)
        unpack.set_min_output_buffer(TUNED_VECTORS)
        total = blocks.integrate_cc(GROUP_LENGTH, 64)
        transform = fft.fft_vcc(64, True, [], False)
        equalize = blocks.multiply_const_vcc(WAVEFORM.equalizer().tolist())
        flowgraph.top.connect(group, weight, unpack, total, transform, equalize)
        ends.append(equalize)
    return flowgraph.end(*ends)


class NumpyScript:
    """What a script does well: the weights as one matrix product on the mapped file."""

    def __init__(self, recording, weights):
        self._recording = recording
        self._weights = weights.astype(np.complex64)
        self._equalizer = WAVEFORM.equalizer().astype(np.complex64)

    def run(self):
        samples = np.memmap(self._recording.fc32, "<c8", "r")[: self._recording.samples]
        frames = samples.reshape(-1, GROUP_LENGTH, WAVEFORM.frame_length)
        first, length = WAVEFORM.first_averaged, 64 * WAVEFORM.repetitions
        groups = []
        for group in frames[:, :, first : first + length]:
            weighted = self._weights @ group
            folded = weighted.reshape(len(weighted), WAVEFORM.repetitions, 64).mean(axis=1)
            groups.append(np.fft.fft(folded) * self._equalizer)
        self.tones = np.array(groups)


def file_to_nowhere(recording, weights):
    """A file source and a null sink: what GNU Radio gives before anything is computed."""
    source = _file_source(recording)
    source.set_min_output_buffer(TUNED_SAMPLES)
    return Flowgraph(source, blocks.null_sink(8))


class MemoryRead:
    """Every byte of the samples read once, in memory that is its own."""

    tones = None

    def __init__(self, recording, weights):
        self._words = np.fromfile(recording.fc32, "<u8", recording.samples)

    def run(self):
        self._words.max()


# Rows of the bench by name: what makes the chain of a recording and weights.
CHAINS = {
    "stream-fc32": partial(stream, item_type="fc32"),
    "stream-sc16": partial(stream, item_type="sc16"),
    "block-by-block": separate_blocks,
    "file-fc32": partial(RecordedTones, item_type="fc32"),
    "file-sc16": partial(RecordedTones, item_type="sc16"),
    "stock-tuned": stock,
    "numpy": NumpyScript,
    "ceiling-file-source": file_to_nowhere,
    "ceiling-read": MemoryRead,
}
