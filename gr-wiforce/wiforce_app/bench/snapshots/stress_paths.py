# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths from samples to phases: blocks in single precision, and a reference in double."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.readings import WEAK_PHASE_DEG
from gnuradio.wiforce.signal.waveform import sounding_waveform

from .cases import air_of, errors_of, plan_of
from .chain import SnapshotChain

WAVEFORM = sounding_waveform()
_NOTHING_DEG = 0.02
PATHS = ("double", "file-fc32", "stream-fc32", "stream-sc16", "block by block", "channel first")


@dataclass(frozen=True)
class Outcome:
    """Touched groups of one run: errors and stated std (n, 2S), and the number without a reading.

    ``not_finite`` counts values that are not finite although they are reported as valid.
    """

    errors_deg: np.ndarray
    std_deg: np.ndarray
    unread: int
    not_finite: int

    @property
    def worst_deg(self):
        """Largest error of what is not flagged weak."""
        errors = np.abs(self.errors_deg)
        return float(np.max(errors[self.std_deg <= WEAK_PHASE_DEG], initial=0.0))

    @property
    def discarded(self):
        """Groups that are not readable or flagged weak."""
        return self.unread + int(np.count_nonzero(np.any(self.std_deg > WEAK_PHASE_DEG, axis=1)))

    @property
    def undetected_deg(self):
        """Largest error beyond four stated standard deviations and 0.02 deg, if unflagged."""
        errors = np.abs(self.errors_deg)
        held = (errors <= 4 * self.std_deg + _NOTHING_DEG) | (self.std_deg > WEAK_PHASE_DEG)
        return float(np.max(errors[~held], initial=0.0))


def read_case(case, path="double", indices=None, scale=None, hurt=None, run=0):
    """One run of a case by one of :data:`PATHS`: its reference groups, then its touched groups.

    ``indices`` are those of the groups, increasing. ``scale`` gives a factor for the samples of
    a numbered group, and ``hurt`` may change its H (N, K).
    """
    air, tags, _ = air_of(case, run)
    settings = plan_of(case, "harmonic")
    count = case.reference_groups + case.groups
    indices = list(range(count)) if indices is None else list(indices)

    def snapshots():
        for number, index in enumerate(indices):
            factor = 1.0 if scale is None else scale(number)
            group = factor * air.group(index, number >= case.reference_groups)
            if hurt is not None:
                hurt(number, group)
            yield group

    chain = SnapshotChain(settings)
    ready = []
    if path == "double":
        for index, group in zip(indices, snapshots(), strict=True):
            ready.append(chain.process(index, group))
    else:
        with tempfile.TemporaryDirectory(prefix="wiforce-stress-") as folder:
            groups, tones, incomplete = _through_blocks(
                path, settings, snapshots(), indices, Path(folder)
            )
        tones = tones[:, :, settings.waveform.bins]
        for row, index in enumerate(groups):
            if index in incomplete:
                ready.append(chain.process(index, *incomplete[index]))
            else:
                ready.append(chain.process_tones(Groups([index], tones[row : row + 1])))
    groups = Groups.concatenate([*ready, chain.flush()])
    touched = groups[groups.index >= indices[case.reference_groups]]
    errors, std, unread = errors_of(case, tags, _numbered(touched, case), "harmonic")
    lost = len(indices) - case.reference_groups - len(touched)
    return Outcome(errors, std, unread + lost, _not_finite(errors, std))


def _numbered(groups, case):
    """Groups with an index in the touched part; infinite std without a reading."""
    unreliable = np.repeat(groups.overlapping | ~groups.locked, 2, axis=1)
    std = np.where(unreliable, np.inf, groups.phase_std_deg)
    index = np.full(len(groups), case.reference_groups)
    return groups.having(index=index, phase_std_deg=std)


def _not_finite(errors, std):
    return int(np.count_nonzero(~np.isfinite(errors)) + np.count_nonzero(~np.isfinite(std)))


def _through_blocks(path, settings, snapshots, indices, folder):
    """Group indices, tones (groups, M, 64), and H and mask of incomplete groups: by C++ blocks."""
    item_type = "sc16" if path.endswith("sc16") else "fc32"
    samples = folder / "samples"
    with open(samples, "wb") as stream:
        for group in snapshots:
            stream.write(_samples(group, item_type))
    flowgraph, sink, messages = _flowgraph(path, item_type, samples, settings, indices)
    flowgraph.run()
    tones = np.array(sink.data(), np.complex64).reshape(
        -1, len(settings.table.tones), WAVEFORM.symbol_length
    )
    return _group_indices(sink, len(tones)), tones, _incomplete(messages)


def _incomplete(messages):
    """H (N, K) and mask (N,) of the groups for which a message was sent."""
    import pmt

    found = {}
    for i in range(messages.num_messages()):
        message = messages.get_message(i)
        meta = pmt.to_python(pmt.car(message))
        mask = np.asarray(meta["mask"], bool)
        folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
        channel = (
            np.fft.fft(folded.reshape(len(mask), WAVEFORM.symbol_length)) * WAVEFORM.equalizer()
        )
        found[int(meta["group"])] = channel[:, WAVEFORM.bins], mask
    return found


def _samples(snapshots, item_type):
    """Frames whose fold and FFT give H (N, K)."""
    spectrum = np.zeros((len(snapshots), WAVEFORM.symbol_length), complex)
    spectrum[:, WAVEFORM.bins] = snapshots / WAVEFORM.equalizer()[WAVEFORM.bins]
    symbol = np.fft.ifft(spectrum, axis=1)
    frames = np.zeros((len(snapshots), WAVEFORM.frame_length), complex)
    frames[:, :320] = np.tile(symbol, 5)
    if item_type == "fc32":
        return frames.astype(np.complex64).tobytes()
    codes = np.stack([frames.real, frames.imag], axis=-1) * _FULL_SCALE / np.abs(frames).max()
    return np.clip(np.rint(codes), -32768, 32767).astype("<i2").tobytes()


_FULL_SCALE = 23000  # -3 dB


def _flowgraph(path, item_type, samples, settings, indices):
    from gnuradio import blocks, gr, wiforce

    from ..throughput.chains import kernel_blocks

    rows, folded = len(settings.table.tones), path == "file-fc32"
    top = gr.top_block("stress", catch_exceptions=False)
    if folded:
        segments = _segments(indices, settings.group_length * WAVEFORM.frame_length)
        source = wiforce.recording_source(str(samples), "cf32_le", segments, WAVEFORM.frame_length)
    else:
        source = blocks.file_source(4 if item_type == "sc16" else 8, str(samples), False)
    order = path if path in ("block by block", "channel first") else "tones first"
    kernels = kernel_blocks(
        order, settings.table.weights, settings.group_length, WAVEFORM, item_type, folded
    )
    chain = [source, *kernels]
    sink = blocks.vector_sink_c(rows * WAVEFORM.symbol_length)
    top.connect(*chain, sink)
    messages = blocks.message_debug(False)
    sender = next(block for block in chain if _has_incomplete_port(block))
    top.msg_connect(sender, "incomplete", messages, "store")
    return top, sink, messages


def _has_incomplete_port(block):
    import pmt

    ports = block.to_basic_block().message_ports_out()
    return "incomplete" in pmt.to_python(ports)


def _segments(indices, group_samples):
    """(file sample, global index, length) of every run of groups without a gap."""
    starts = [0] + [i for i in range(1, len(indices)) if indices[i] != indices[i - 1] + 1]
    stops = [*starts[1:], len(indices)]
    return [
        (a * group_samples, (indices[a] - indices[0]) * group_samples, (b - a) * group_samples)
        for a, b in zip(starts, stops, strict=True)
    ]


def _group_indices(sink, count):
    import pmt

    indices = {
        tag.offset: pmt.to_uint64(tag.value)
        for tag in sink.tags()
        if pmt.symbol_to_string(tag.key) == "group"
    }
    return [indices[offset] for offset in range(count)]
