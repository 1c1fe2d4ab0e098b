# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of recordings and streams: where they are, or what keeps them from being read."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator

import numpy as np

from ...errors import InputError
from ...io.capture.recordings import Capture
from ...io.capture.samples import plausible_share
from ...signal.waveform import WAVEFORMS, Waveform, sounding_waveform
from ..groups import Array
from .frame import (
    SEARCHED_SAMPLES,
    describe_frames,
    elsewhere,
    find_frame_offset,
    find_frame_period,
    frame_offset_in,
    frame_powers,
    has_quiet_samples,
    repeats_every_frame,
    samples_needed,
    searched_samples,
    symbols_in,
)

# Where frames are searched when there are none at the start: at doubling distances from it, and so
# often over the rest.
_POSITIONS = 24
# Samples of a last, longer search: 6 dB more sensitive.
_LONG_SEARCH = 1 << 20
# Share of the power of frames from which on one is received, and no noise before them. Half and
# twice as much find the same frame down to an SNR of -5 dB; below, noise before them is read too.
_RECEIVED = 0.1
# Static paths that leave less likeness than this between preamble and symbol have not been seen: of
# all shipped scenes 0.6 is the least. Another rate or waveform leaves 0.03 to 0.3.
_UNLIKELY = 0.4
# Frames that leave less do not tell their length: other periodic signals leave up to 0.1.
_FAINT = 0.15
# Frames of one length that may take as long as some of another.
_FEW_FRAMES = 16
_SWAPPED = "I and Q are swapped, the spectrum is inverted, or another sounding.waveform was sent"
# Sample rates of the receiver over the transmitter's that are tried.
SAMPLE_RATE_RATIOS = (2, 4, 8, 0.5, 0.25, 1.25, 1.6, 2.5, 5, 10, 0.8, 0.625, 0.4)


def find_frames(recording: Capture, waveform: Waveform) -> int | None:
    """Sample from which on the expected frames are received, or None; refuses others."""
    needed = samples_needed(waveform.frame_length)
    for place in _places(recording.span, needed):
        samples = recording.read_span(place, needed)
        if _agrees(recording, waveform, place, samples):
            return place
    # Before weak frames are searched in more samples: strong ones of another kind may explain why.
    samples = recording.read_span(0, max(_LONG_SEARCH, searched_samples(waveform)))
    _check_kind(recording, waveform, samples[:needed])
    if _agrees(recording, waveform, 0, samples[: max(_LONG_SEARCH, needed)]):
        return 0
    return 0 if _stands_out(samples, waveform) else None


def _require_frames(recording: Capture, waveform: Waveform) -> int:
    """As :func:`find_frames`; refuses a recording without frames as well."""
    place = find_frames(recording, waveform)
    if place is not None:
        return place
    needed = samples_needed(waveform.frame_length)
    rule = "holds no whole frame of finite samples"
    for part in _places(recording.span, needed):
        if np.isfinite(recording.read_span(part, needed)).any():
            check = f"check the datatype ({recording.datatype}), radio.sample_rate_hz and "
            frames = f"no sounding frames found ({describe_frames(waveform)})"
            rule = f"{frames}; {check}sounding.frame_length"
            break
    raise InputError(recording.path, rule)


def first_frame(recording: Capture, waveform: Waveform) -> tuple[int, int]:
    """Samples before the first frame, 0 where none is needed, and a sample with frames behind it.

    Refuses a recording without the expected frames.
    """
    place = _require_frames(recording, waveform)
    # On the grid that begins with the first sample, frames are where they are at the start.
    start = place - place % waveform.frame_length
    samples = recording.read_span(start, searched_samples(waveform))
    offset = frame_offset_in(samples, waveform)
    return _first_received(recording, waveform, offset, start + offset), place


def _first_received(recording: Capture, waveform: Waveform, offset: int, place: int) -> int:
    """Sample of the first frame that is received; ``place`` is that of any which is.

    Recorders are often started before the transmitter, and the first groups are the reference.
    """
    length = waveform.frame_length
    block = samples_needed(length) // length * length

    def powers(begin: int, count: int = block) -> Array:
        return frame_powers(recording.read_span(begin, count), waveform)

    least = _RECEIVED * float(np.mean(powers(place)))
    begins = range(offset + (place - offset) % block, place, block)
    first = bisect_left(begins, True, key=lambda begin: bool(np.mean(powers(begin)) > least))
    begin = max(offset, begins.start + (first - 1) * block)
    return begin + length * int(np.argmax(powers(begin, 2 * block) > least))


def _places(span: int, needed: int) -> Iterator[int]:
    """Samples at which frames are searched, the first one first."""
    last = max(0, span - needed)
    place, step = 0, needed
    while place < last:
        yield place
        place, step = place + step, 2 * step
    yield from np.unique(np.linspace(0, last, _POSITIONS).astype(int))[1:].tolist() or [last]


def _stands_out(samples: Array, waveform: Waveform) -> bool:
    """Whether the mean of many frames holds a preamble, in both halves at the same place."""
    half = len(samples) // waveform.frame_length // 2 * waveform.frame_length
    first, second = (find_frame_offset(part, waveform) for part in (samples[:half], samples[half:]))
    return first is not None and first == second


def _agrees(recording: Capture, waveform: Waveform, place: int, samples: Array) -> bool:
    """Whether the samples hold the expected frames; refuses others, and other frame lengths."""
    found, expected = find_frame_period(samples, waveform), waveform.frame_length
    if found.samples is None or not found.agrees and found.likeness < _FAINT:
        return False
    if found.likeness < _UNLIKELY:
        _check_kind(recording, waveform, samples[:SEARCHED_SAMPLES], found.likeness)
    if found.agrees or found.samples == expected:
        return True
    # Another signal may repeat as well, a tone or the frames of a second reader. Both together
    # repeat after a multiple of our frame, which a longer frame alone does not fill.
    if found.samples % expected == 0 and repeats_every_frame(samples, waveform):
        return True
    # The second reader may also be the stronger one: the mean of many frames shows ours.
    if has_quiet_samples(waveform) and not _commensurate(found.samples, expected):
        samples = recording.read_span(place, searched_samples(waveform))
        if _stands_out(samples, waveform):
            return True
    raise InputError(recording.path, _other_length(found.samples, expected))


def _other_length(samples: float, expected: int) -> str:
    rule = f"frames repeat every {samples:.6g} samples, but sounding.frame_length is {expected}"
    if samples != round(samples):
        rule += "; receiver and transmitter ran at different sample rates"
    return rule


def _commensurate(period: float, expected: int) -> bool:
    """Whether a few frames of one length take as long as a few of the other."""
    counts = np.arange(1, _FEW_FRAMES + 1) * period / expected
    return bool(np.any((counts == np.rint(counts)) & (counts <= _FEW_FRAMES)))


def _check_kind(
    recording: Capture, waveform: Waveform, samples: Array, likeness: float = 0.0
) -> None:
    """Refuse preambles that another waveform or another sample rate explains far better."""
    rule = other_frames(samples, waveform, likeness)
    if rule:
        raise InputError(recording.path, rule)


def other_frames(samples: Array, waveform: Waveform, likeness: float = 0.0) -> str:
    """Which other waveform or rate explains some dozen frames far better; empty where none does."""
    clear = max(_UNLIKELY, 2 * likeness)
    for other in _other_waveforms(waveform):
        if find_frame_period(samples, other).likeness > clear:
            rule = f"the preambles are those of {other.name!r}, but sounding.waveform is"
            return f"{rule} {waveform.name!r}"
    symbol = waveform.symbol
    if find_frame_period(samples, waveform, symbol.conj()).likeness > clear:
        return _SWAPPED
    for ratio in SAMPLE_RATE_RATIOS:
        found = find_frame_period(samples, waveform, _resampled(symbol, ratio))
        if found.samples is not None and found.likeness > clear:
            return (
                f"symbols have {len(symbol) * ratio:g} samples instead of {len(symbol)}, and "
                f"frames repeat every {found.samples:.6g} samples: the receiver's sample rate was "
                f"{ratio:g} times that of the transmitter "
                f"(radio.sample_rate_hz is {waveform.sample_rate_hz:.12g})"
            )
    return ""


def _other_waveforms(waveform: Waveform) -> Iterator[Waveform]:
    """Shipped waveforms, as they are sent by default, whose frames are as long."""
    for name in WAVEFORMS:
        try:
            other = sounding_waveform(name, waveform.frame_length, waveform.sample_rate_hz)
        except InputError:
            continue  # its preamble is longer than the frame
        if name != waveform.name:
            yield other


def _resampled(symbol: Array, ratio: float) -> Array:
    """A symbol as a receiver samples it whose rate is so many times the transmitter's."""
    length = round(len(symbol) * ratio)
    half = min(length, len(symbol)) // 2
    spectrum, wider = np.fft.fft(symbol), np.zeros(length, complex)
    wider[:half], wider[-half:] = spectrum[:half], spectrum[-half:]
    return np.fft.ifft(wider)


# Full scale of both I and Q is 3.01 dBFS. The quantisation noise of 16 bits, 2 (2^-15)^2 / 12, is
# -98 dBFS, and folding lowers it by 6 dB; what is weaker was not sent by a converter.
_MOST_DBFS, _LEAST_DBFS = 3.1, -105.0
# Share of floats of a plausible size below which they are integers that are read as floats: their
# exponents are spread evenly, and a fifth is plausible; damaged files of floats have 95 %.
_FLOAT_SHARE = 0.5
ALL_FLAGGED = (
    "every reading is flagged; check the datatype, and clock_hz, frame_length and sample_rate_hz, "
    "or packets, of the scene, and the signal level"
)
# Part of the snapshots' power that is the same in all of them, times their number: 1 for noise with
# a standard deviation of 1/8 over a symbol's 64 samples.
_COHERENT, _FEWEST = 3.0, 16
# Above 20 the noise takes at most 5 % of the power from the paths. In simulated rooms a quarter of
# the symbol holds 97 %, where frames have another waveform or length at most 50 %.
_CLEAR, _SHORT_PATHS = 20.0, 0.7


def level_problem(samples: Array) -> str:
    """Improbable values of samples of full scale 1; empty otherwise."""
    samples = np.ascontiguousarray(samples, np.complex64).ravel()
    if not len(samples):
        return ""
    finite = samples[np.isfinite(samples)]
    if not len(finite):
        return "all samples are NaN or infinite; check the block that makes them"
    if plausible_share(samples.view(np.float32)) < _FLOAT_SHARE:
        return (
            "the samples have values that 16-bit integers have when they are read as floats; "
            "check the type of the source, and the input type"
        )
    power = float(np.mean(np.abs(finite.astype(complex)) ** 2))
    if not power:
        return "all samples are 0; check that the source delivers a signal"
    level = 10 * math.log10(power)
    if level > _MOST_DBFS:
        return (
            f"the samples have {level:.0f} dBFS, full scale being 1; lower the level, or divide "
            "integers of 16 bits by 32768"
        )
    if level < _LEAST_DBFS:
        return (
            f"the samples have {level:.0f} dBFS, less than the noise of a converter; check the "
            "scale and the type of the source"
        )
    return ""


def snapshots_problem(folded: Array, waveform: Waveform) -> str:
    """Why the folded frames (N, symbol_length) of a group cannot be those of frames, or empty."""
    if len(folded) < _FEWEST:
        return ""
    mean = folded.mean(axis=0)
    power = float(np.mean(np.abs(folded) ** 2))
    coherent = float(np.mean(np.abs(mean) ** 2)) / max(power, 1e-30) * len(folded)
    if coherent < _COHERENT:
        return _no_frames(waveform)
    if coherent > _CLEAR and _short_paths(mean, waveform) < _SHORT_PATHS:
        if _short_paths(mean.conj(), waveform) >= _SHORT_PATHS:
            return _SWAPPED
        return (
            f"frames are received, but not those of the scene ({describe_frames(waveform)}); check "
            "its waveform, frame length and sample rate, and the type of the samples"
        )
    return ""


def _short_paths(mean: Array, waveform: Waveform) -> float:
    """Share of the channel's power within the quarter of a symbol that holds most of it."""
    channel = np.zeros(waveform.symbol_length, complex)
    channel[waveform.bins] = (np.fft.fft(mean) * waveform.equalizer())[waveform.bins]
    paths = np.abs(np.fft.ifft(channel)) ** 2
    quarter = len(paths) // 4
    sums = np.cumsum(np.concatenate([paths, paths[:quarter]]))
    return float(np.max(sums[quarter:] - sums[:-quarter]) / max(paths.sum(), 1e-30))


def frame_problem(samples: Array, waveform: Waveform, frame_offset: int) -> str:
    """Where frames begin if not at ``frame_offset``, from many frames or their mean; or empty."""
    if problem := preamble_problem(samples, waveform):
        return problem
    begin = elsewhere(samples, waveform)
    if begin is None:
        return ""
    length = waveform.frame_length
    return (
        f"frames begin at sample {(frame_offset + begin) % length} and every {length} from there, "
        f"not at sample {frame_offset}; set the frame offset, or put a Frame Alignment before a "
        "Reader"
    )


def preamble_problem(samples: Array, waveform: Waveform) -> str:
    """Of how many symbols preambles consist that hold fewer than are averaged; empty otherwise."""
    count, sent = symbols_in(samples, waveform), waveform.preamble_length // waveform.symbol_length
    if count >= waveform.repetitions:
        return ""
    return (
        f"preambles hold {count} symbol{'' if count == 1 else 's'}, but sounding.repetitions is "
        f"{sent}: readings are distorted by what is received behind them"
    )


def search_problem(samples: Array, waveform: Waveform, ended: str = "") -> str:
    """Why no frames of a waveform were found in samples; at least: their stream has ``ended``."""
    problem = level_problem(samples)
    if problem:
        return problem
    found = find_frame_period(samples, waveform)
    problem = other_frames(samples[:SEARCHED_SAMPLES], waveform, found.likeness)
    if not problem and found.samples is not None and not found.agrees:
        return _other_length(found.samples, waveform.frame_length)
    return problem or ended or _no_frames(waveform)


def capture_problem(recording: Capture, waveform: Waveform, frame_offset: int) -> str:
    """Why a recording cannot be read from a sample on, with its name; empty if it can."""
    samples = recording.read_span(frame_offset, samples_needed(waveform.frame_length))
    problem = level_problem(samples)
    if problem:
        return f"{recording.path}: {problem}"
    try:
        place = _require_frames(recording, waveform)
    except InputError as error:
        return str(error)
    problem = offset_problem(recording, waveform, place, frame_offset)
    return problem and f"{recording.path}: {problem}"


def offset_problem(recording: Capture, waveform: Waveform, place: int, frame_offset: int) -> str:
    """Where frames received from ``place`` on begin, if not at ``frame_offset``; or empty."""
    place += (frame_offset - place) % waveform.frame_length
    samples = recording.read_span(place, searched_samples(waveform))
    return frame_problem(samples, waveform, frame_offset)


def _no_frames(waveform: Waveform) -> str:
    return (
        f"no frames of the scene are received ({describe_frames(waveform)}), only noise or another "
        "signal; check the transmitter, the carrier, the sample rate, and the type of the samples"
    )
