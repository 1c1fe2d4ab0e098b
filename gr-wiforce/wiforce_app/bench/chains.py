# SPDX-License-Identifier: GPL-3.0-or-later
"""The chains that are compared. Each makes a function that runs it once, and its tones."""

from functools import partial

import numpy as np
from gnuradio import blocks, fft, gr, wiforce
from gnuradio.wiforce.blocks.group_block import SnapshotSink
from gnuradio.wiforce.wiforce_kernels import tone_reader, tone_transform

from .recording import GROUP_LENGTH, WAVEFORM

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


def sample_type(recording, item_type):
    """(path, bytes per sample, SigMF's name) of one of a recording's two files."""
    if item_type == "sc16":
        return str(recording.sc16), 4, "ci16_le"
    return str(recording.fc32), 8, "cf32_le"


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
    path, size, _ = sample_type(recording, item_type)
    return blocks.file_source(size, path, False, 0, recording.samples)


def planned(settings, recordings, source, order="tones first", segments=None, derotated=False):
    """The tones of a plan from recordings of each antenna, by ``source`` and ``order``."""
    kind, item_type = source.split("-")
    waveform, table, folded = settings.waveform, settings.table, kind == "file"
    rotation = None
    if derotated:
        rotation = table.derotation(waveform.sample_rate_hz, waveform.symbol_length)
    sources = [_file_source(recording, item_type) for recording in recordings]
    if folded:
        segments = segments or [(0, 0, recordings[0].samples)]
        files = [sample_type(recording, item_type) for recording in recordings]
        sources = [
            wiforce.recording_source(path, datatype, segments, **waveform.folding)
            for path, _, datatype in files
        ]
    row = kernel_blocks(
        order, table.weights, settings.group_length, waveform, item_type, folded, rotation
    )
    if len(sources) == 2:
        row.insert(
            0, wiforce.antenna_ratio(waveform.name, waveform.frame_length, waveform.sample_rate_hz)
        )
    flowgraph = Flowgraph(sources[0], *row).end(row[-1])
    for port, other in enumerate(sources[1:], 1):
        flowgraph.top.connect(other, (row[0], port))
    return flowgraph


def kernel_blocks(
    order, weights, group_length, waveform=WAVEFORM, item_type="fc32", folded=False, rotation=None
):
    """Blocks from samples, or folded ones, to the channel at tones of weights (M, group_length).

    ``order``: ``tones first``, ``block by block`` (snapshots between), ``channel first``.
    """
    frame = {**waveform.folding, "item_type": item_type}
    group = {"weights": weights, "group_length": group_length}
    factors = waveform.equalizer().astype(np.complex64)
    fold = [] if folded else [wiforce.preamble_fold(**frame)]
    if order == "channel first":
        estimator = wiforce.ofdm_channel_estimator(factors, 1)
        return [*fold, estimator, wiforce.phase_group_doppler(**group)]
    rotations = () if rotation is None else (rotation.astype(np.complex64),)
    estimator = wiforce.ofdm_channel_estimator(factors, len(weights), *rotations)
    if order == "tones first" and fold:
        return [wiforce.preamble_fold.tones(**group, **frame), estimator]
    return [*fold, wiforce.phase_group_doppler(**group), estimator]


def separate_blocks(recording, weights):
    """Folding and tones in a block each, as a flowgraph that shows the snapshots has it."""
    row = kernel_blocks("block by block", weights, GROUP_LENGTH)
    return Flowgraph(_file_source(recording), *row).end(row[-1])


class RecordedTones:
    """A whole recording read without a flowgraph."""

    def __init__(self, recording, weights, item_type):
        path, _, datatype = sample_type(recording, item_type)
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


def stock(recording, weights, tuned):
    """GNU Radio's own blocks: keep what is averaged, fold, weight a group at once, sum."""
    source = _file_source(recording)
    keep = blocks.keep_m_in_n(8, 64 * WAVEFORM.repetitions, WAVEFORM.frame_length, 64)
    pack = blocks.stream_to_vector(8, 64)
    fold = blocks.integrate_cc(WAVEFORM.repetitions, 64)
    group = blocks.stream_to_vector(8 * 64, GROUP_LENGTH)
    if tuned:
        source.set_min_output_buffer(TUNED_SAMPLES)
        keep.set_min_output_buffer(TUNED_SAMPLES // 2)
        pack.set_min_output_buffer(4 * TUNED_VECTORS)
        fold.set_min_output_buffer(TUNED_VECTORS)
        group.set_min_output_buffer(4)
    flowgraph, ends = Flowgraph(source, keep, pack, fold, group), []
    for row in weights / WAVEFORM.repetitions:
        weight = blocks.multiply_const_vcc(np.repeat(row, 64).astype(np.complex64).tolist())
        unpack = blocks.vector_to_stream(8 * 64, GROUP_LENGTH)
        if tuned:
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
    "stock-default": partial(stock, tuned=False),
    "stock-tuned": partial(stock, tuned=True),
    "numpy": NumpyScript,
    "ceiling-file-source": file_to_nowhere,
    "ceiling-read": MemoryRead,
}
