# SPDX-License-Identifier: GPL-3.0-or-later
"""The chains that are compared. Each makes a function that runs it once, and its tones."""

import numpy as np
from gnuradio import blocks, fft, gr, wiforce
from gnuradio.wiforce.blocks.group_block import SnapshotSink
from gnuradio.wiforce.wiforce_kernels import tone_reader, tone_transform

from .recording import GROUP_LENGTH, WAVEFORM

# Rows of the bench by name: what makes the chain, and its settings.
CHAINS = {}

# What a skilled user ends at for the stock chain: samples and vectors per buffer. More or less
# of either is slower.
TUNED_SAMPLES, TUNED_VECTORS = 131072, 128


def chain(name, **settings):
    """Enters a chain under a name; called as chain(recording, weights)."""

    def enter(function):
        CHAINS[name] = lambda recording, weights: function(recording, weights, **settings)
        return function

    return enter


class Flowgraph:
    """A flowgraph that is run once."""

    def __init__(self):
        self.top = gr.top_block()
        self._sinks = []

    def row(self, *chain):
        """Connects blocks in a row, of which the last one gives the tones."""
        self.top.connect(*chain)
        self.end(chain[-1])
        self._kept = chain  # Python blocks are freed when no name refers to them

    def end(self, *blocks_of_rows):
        """Ends the chain, or its chains of some rows each."""
        for block in blocks_of_rows:
            length = block.output_signature().sizeof_stream_item(0) // gr.sizeof_gr_complex
            self._sinks.append((blocks.vector_sink_c(length), length // 64))
            self.top.connect(block, self._sinks[-1][0])

    def run(self):
        self.top.run()

    @property
    def tones(self):
        """(groups, M, 64), or None of a chain without."""
        if not self._sinks:
            return None
        parts = [np.array(s.data(), np.complex64).reshape(-1, m, 64) for s, m in self._sinks]
        groups = min(map(len, parts))
        return np.concatenate([part[:groups] for part in parts], axis=1)


def sample_type(recording, item_type):
    """(path, bytes per sample, SigMF's name) of one of a recording's two files."""
    if item_type == "sc16":
        return str(recording.sc16), 4, "ci16_le"
    return str(recording.fc32), 8, "cf32_le"


class ToneSink(SnapshotSink):
    """Computes the tones (M, 64) of complete groups as the Reader does, without reading them.

    The Reader's own block surveys and reads the groups as well, which ``bench read`` measures.
    """

    def __init__(self, weights):
        SnapshotSink.__init__(self, "tone_sink", GROUP_LENGTH, WAVEFORM.symbol_length)
        bins = range(WAVEFORM.symbol_length)
        self._kernel = tone_transform(weights, WAVEFORM.equalizer(), np.zeros(0), bins)
        self.tones = []

    def read(self, groups):
        if not all(group.kept is self.everything for group in groups):
            raise ValueError("a group of this stream is complete and without interference")
        self.tones += [self._kernel.transform(group.folded) for group in groups]


class StreamedTones:
    """A flowgraph of blocks in a row, of which the last one keeps the tones."""

    def __init__(self, *blocks_in_order):
        self._top = gr.top_block()
        self._top.connect(*blocks_in_order)
        self._sink = blocks_in_order[-1]

    def run(self):
        self._top.run()
        if self._sink.failure is not None:
            raise self._sink.failure

    @property
    def tones(self):
        return np.array(self._sink.tones)


@chain("stream-fc32", item_type="fc32")
@chain("stream-sc16", item_type="sc16")
def stream(recording, weights, item_type):
    """Folding and tones as the Reader computes them, behind a file source."""
    path, size, _ = sample_type(recording, item_type)
    source = blocks.file_source(size, path, False, 0, recording.samples)
    collected = wiforce.preamble_fold.collected(
        GROUP_LENGTH, WAVEFORM.frame_length, item_type=item_type
    )
    return StreamedTones(source, collected, ToneSink(weights))


def kernel_blocks(
    order, weights, group_length, waveform=WAVEFORM, item_type="fc32", folded=False, rotation=None
):
    """Blocks from samples to the channel at each tone of weights (M, group_length).

    ``order`` is ``tones first``, ``block by block`` (snapshots in between) or ``channel first``
    (the channel of each snapshot in between); a ``folded`` source gives snapshots, as a recording
    source does; by ``rotation`` (M, symbol) tones are derotated within a symbol.
    """
    frame = {**waveform.folding, "item_type": item_type}
    group = {"weights": weights, "group_length": group_length}
    factors = waveform.equalizer().astype(np.complex64)
    fold = [] if folded else [wiforce.preamble_fold(**frame)]
    if order == "channel first":
        estimator = wiforce.ofdm_channel_estimator(factors, 1)
        return [*fold, estimator, wiforce.phase_group_doppler(**group)]
    rotations = () if rotation is None else (rotation,)
    estimator = wiforce.ofdm_channel_estimator(factors, len(weights), *rotations)
    if order == "tones first" and fold:
        return [wiforce.preamble_fold.tones(**group, **frame), estimator]
    return [*fold, wiforce.phase_group_doppler(**group), estimator]


@chain("block-by-block")
def separate_blocks(recording, weights):
    """Folding and tones in a block each, as a flowgraph that shows the snapshots has it."""
    flowgraph = Flowgraph()
    source = blocks.file_source(8, str(recording.fc32), False, 0, recording.samples)
    flowgraph.row(source, *kernel_blocks("block by block", weights, GROUP_LENGTH))
    return flowgraph


@chain("file-fc32", item_type="fc32")
@chain("file-sc16", item_type="sc16")
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


@chain("stock-default", tuned=False)
@chain("stock-tuned", tuned=True)
def stock(recording, weights, tuned):
    """GNU Radio's own blocks: keep what is averaged, fold, weight a group at once, sum."""
    flowgraph = Flowgraph()
    source = blocks.file_source(8, str(recording.fc32), False, 0, recording.samples)
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
    flowgraph.top.connect(source, keep, pack, fold, group)
    ends = []
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
    flowgraph.end(*ends)
    return flowgraph


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


CHAINS["numpy"] = NumpyScript


@chain("ceiling-file-source")
def file_to_nowhere(recording, weights):
    """A file source and a null sink: what GNU Radio gives before anything is computed."""
    flowgraph = Flowgraph()
    source = blocks.file_source(8, str(recording.fc32), False, 0, recording.samples)
    source.set_min_output_buffer(TUNED_SAMPLES)
    flowgraph.top.connect(source, blocks.null_sink(8))
    return flowgraph


class MemoryRead:
    """Every byte of the samples read once, in memory that is its own."""

    tones = None

    def __init__(self, recording, weights):
        self._words = np.fromfile(recording.fc32, "<u8", recording.samples)

    def run(self):
        self._words.max()


CHAINS["ceiling-read"] = MemoryRead
