# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of a recording: whether its samples hold the frames that are expected, and where."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...errors import InputError
from ...io.capture.recordings import Capture
from ...signal.waveform import WAVEFORMS, Waveform, sounding_waveform
from ..groups import Array
from .frame import (
    describe_frames,
    find_frame_offset,
    frame_offset_in,
    has_quiet_samples,
    searched_samples,
)
from .frame_period import (
    SEARCHED_SAMPLES,
    find_frame_period,
    likeness_of_mean,
    repeats_every_frame,
    samples_needed,
    symbol_of,
)

# Where frames are searched when there are none at the start: at doubling distances from it, and so
# often over the rest.
_PLACES = 24
# Samples of a last, longer search: 6 dB more sensitive.
_LONG_SEARCH = 1 << 20
# Static paths that leave less likeness than this between preamble and symbol have not been seen: of
# all shipped scenes 0.6 is the least. Another rate or waveform leaves 0.03 to 0.3.
_UNLIKELY = 0.4
# Frames that leave less do not tell their length: other periodic signals leave up to 0.1.
_FAINT = 0.15
# Likeness of the mean frame to the preamble that noise exceeds once in 1e11 recordings.
_LIKE_PREAMBLE = 0.1
# Frames of one length that may take as long as some of another.
_FEW_FRAMES = 16
# Sample rates of the receiver over the transmitter's that are tried.
_RATIOS = (2, 4, 8, 0.5, 0.25, 1.25, 1.6, 2.5, 5, 10, 0.8, 0.625, 0.4)


def find_frames(recording: Capture, waveform: Waveform, start: int = 0) -> int | None:
    """Find a place of a recording at which the expected frames are received.

    Returns int or None: sample at or after which frames were found: ``start``, unless it is silent
    there. None where there are none.

    Parameters
    ----------
    waveform : Waveform
        As it is expected.
    start : int
        Sample from which on they are searched.

    Raises
    ------
    InputError
        When the preambles are those of another waveform or sample rate, or when frames repeat
        after another number of samples. The message names file, key, and what was found.
    """
    needed = samples_needed(waveform.frame_length)
    for place in _places(start, recording.span, needed):
        samples = recording.read_span(place, needed)
        if _agrees(recording, waveform, place, samples):
            return place
    # Before weak frames are searched in more samples: strong ones of another kind may explain why.
    samples = recording.read_span(start, max(_LONG_SEARCH, searched_samples(waveform)))
    _check_kind(recording, waveform, samples[:needed])
    if _agrees(recording, waveform, start, samples[: max(_LONG_SEARCH, needed)]):
        return start
    return start if _stands_out(samples, waveform) else None


def require_frames(recording: Capture, waveform: Waveform) -> int:
    """Find a place at which the expected frames are received, or refuse the recording.

    Returns int: sample at or after which frames were found.

    Parameters
    ----------
    recording, waveform
        As for :func:`find_frames`.

    Raises
    ------
    InputError
        As :func:`find_frames`, and when there are no frames.
    """
    place = find_frames(recording, waveform)
    if place is None:
        needed = samples_needed(waveform.frame_length)
        for part in _places(0, recording.span, needed):
            if np.isfinite(recording.read_span(part, needed)).any():
                raise no_frames(recording, waveform)
        raise InputError(recording.path, "holds no whole frame of finite samples")
    return place


def no_frames(recording: Capture, waveform: Waveform) -> InputError:
    """The error to raise where no frames are found.

    Parameters
    ----------
    recording, waveform
        As for :func:`find_frames`.
    """
    check = f"check the datatype ({recording.datatype}), radio.sample_rate_hz and "
    rule = f"no sounding frames found ({describe_frames(waveform)}); {check}sounding.frame_length"
    return InputError(recording.path, rule)


def first_frame(recording: Capture, waveform: Waveform, place: int = 0) -> int:
    """Samples of a recording before its first frame.

    Returns int: 0 where frames taken from sample 0 hold their preambles, and where none stands out.

    Parameters
    ----------
    place : int
        Sample from which on there are frames (:func:`find_frames`).
    """
    length = waveform.frame_length
    # On the grid that begins with the first sample, frames are where they are at the start.
    place -= place % length
    return frame_offset_in(recording.read_span(place, searched_samples(waveform)), waveform)


def _places(start: int, span: int, needed: int) -> Iterator[int]:
    """Samples at which frames are searched, the first one first."""
    last = max(start, span - needed)
    step = needed
    place = start
    while place < last:
        yield place
        place, step = place + step, 2 * step
    yield from np.unique(np.linspace(start, last, _PLACES).astype(int))[1:].tolist() or [last]


def _stands_out(samples: Array, waveform: Waveform) -> bool:
    """Whether the mean of many frames holds a preamble, in both halves at the same place."""
    half = len(samples) // waveform.frame_length // 2 * waveform.frame_length
    if not half or likeness_of_mean(samples, waveform) < _LIKE_PREAMBLE:
        return False
    first, second = (find_frame_offset(part, waveform) for part in (samples[:half], samples[half:]))
    return first is not None and first == second


def _agrees(recording: Capture, waveform: Waveform, place: int, samples: Array) -> bool:
    """Whether the samples hold the expected frames; False where no frames can be seen.

    Preambles of another kind, and frames of another length, are refused.
    """
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
    rule = (
        f"frames repeat every {found.samples:.6g} samples, but sounding.frame_length is {expected}"
    )
    if found.samples != round(found.samples):
        rule += "; receiver and transmitter ran at different sample rates"
    raise InputError(recording.path, rule)


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
    """Which other waveform or sample rate explains preambles far better than the expected one.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        Some dozen frames, from any sample on.
    waveform : Waveform
        As it is expected.
    likeness : float
        Of the samples to this waveform (:class:`.frame_period.FramePeriod`).

    Returns
    -------
    str
        Empty where none does.

    Examples
    --------
    >>> sent = np.tile(sounding_waveform("wifi", 720).frame(), 40)
    >>> other_frames(sent, sounding_waveform())
    "the preambles are those of 'wifi', but sounding.waveform is 'repeated'"
    """
    clear = max(_UNLIKELY, 2 * likeness)
    for other in _other_waveforms(waveform):
        if find_frame_period(samples, other).likeness > clear:
            rule = f"the preambles are those of {other.name!r}, but sounding.waveform is"
            return f"{rule} {waveform.name!r}"
    symbol = symbol_of(waveform)
    if find_frame_period(samples, waveform, symbol.conj()).likeness > clear:
        return (
            "I and Q are swapped, the spectrum is inverted, or another sounding.waveform was sent"
        )
    for ratio in _RATIOS:
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
