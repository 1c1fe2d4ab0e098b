# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame period: after how many samples the preambles of a stream repeat."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...signal.waveform import Waveform
from ..groups import Array
from .frame import whole_frames

# Samples in which the period is searched: 90 frames of the default length, 15 ms of processing.
# Longer frames need more, since a period shows in at least four of them.
SEARCHED_SAMPLES = 1 << 16
_LEAST_FRAMES = 4
# A period must show at so many of its multiples. This tells it from echoes and from the repetitions
# within a preamble, which show at single lags: 4 of 5 symbols still coincide when a preamble is
# shifted by one, but none when the shift has grown to the length of the preamble.
_MULTIPLES = 8
# A lag counts as periodic above so many standard deviations of the lags without signal. Of 3e4 lags
# of Gaussian noise the largest lies at 4.2. Below this value nothing is said, since noise on the
# preambles themselves then changes the coherence of a true period too much to rank it.
_CLEAR = 20.0
_NOISE = 5.0
# Two lags are periods alike when their coherence agrees to this factor, and to the noise. Shifts by
# one symbol keep 0.8 of it, and less at their multiples.
_SAME = 0.85
_LEAST_SAME = 0.7
# Share of the highest coherence that a period has at least; other lags have up to 0.4.
_LEAST_SHARE = 0.45
# Half a sample off, 0.4 of the likeness remain, and 0.2 of the coherence.
_FRACTION_SAME = 0.15
# Share of a frame's preamble that repeats in the next; 0 where every second frame is missing.
_PRESENT = 0.3
# Its least power over that of the strongest other signal.
_LOUD = 0.03
# Least likeness of frames without a guard, since any signal with the same period has their
# coherence. Random symbols leave up to 0.3 to one another, static paths 0.6 or more to their own.
_LIKE_SYMBOL = 0.4
# Variance of the likeness: that of noise is 2e-4; that of a pure tone is rounding.
_LEAST_VARIANCE = 1e-6


@dataclass(frozen=True)
class FramePeriod:
    """What the samples of a stream say of the length of its frames.

    Attributes
    ----------
    samples : float or None
        Samples after which the preambles repeat; None where that does not stand out of the noise.
        Not an integer when transmitter and receiver ran at different sample rates.
    agrees : bool
        True where the expected length of a frame is a period, and no part of it is.
    likeness : float
        Mean over all frames of the normalised correlation with the sounding symbol, at the place
        within the frame where it is highest; 1 for the symbol without noise and echoes, about
        0.1 for other signals.
    """

    samples: float | None
    agrees: bool
    likeness: float = 0.0


def samples_needed(frame_length: int) -> int:
    """Samples in which :func:`find_frame_period` can confirm a frame length."""
    return max(SEARCHED_SAMPLES, _LEAST_FRAMES * frame_length)


def find_frame_period(
    samples: Array, waveform: Waveform, symbol: Array | None = None
) -> FramePeriod:
    """Find after how many samples the preambles of a stream repeat.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        Some dozen frames, from any sample on; samples lost in a gap are zeros.
    waveform : Waveform
        As it is expected.
    symbol : ndarray of complex, shape (m,), optional
        Samples of a symbol to search for instead of the waveform's.

    Notes
    -----
    Each sample is given the normalised correlation of the samples from there with the sounding
    symbol, q = |<s, y>|^2 / (|s|^2 |y|^2). It depends on neither level nor carrier offset, and it
    ignores DC and most of what is no preamble. A period is a lag at which, and at whose multiples,
    the autocovariance of q is high. The shortest such lag of at least a preamble is the length of a
    frame.
    """
    if symbol is None:
        symbol = symbol_of(waveform)
    if len(samples) < waveform.preamble_length + 2 * waveform.symbol_length:
        return FramePeriod(None, False)
    likeness = _likeness(samples, symbol)
    coherence = _coherence_of_lags(likeness)
    strength, spread = _strength_of_periods(coherence, waveform.preamble_length)
    period, agrees = _period_in(coherence, strength, spread, waveform)
    least = 0.0
    if period is None and waveform.frame_length < waveform.preamble_length + len(symbol):
        spread, least = min(spread, _spread_without_guard(coherence, waveform)), _LIKE_SYMBOL
        period, agrees = _period_in(coherence, strength, spread, waveform)
    if period is None:
        return FramePeriod(None, False)
    found = round(float(_mean_frame(likeness, period).max()), 6)
    return FramePeriod(period, agrees, found) if found >= least else FramePeriod(None, False)


def symbol_of(waveform: Waveform) -> Array:
    """Samples of the symbol whose repetitions are averaged.

    Returns ndarray of complex, shape (symbol_length,).
    """
    return waveform.symbol


def _period_in(
    coherence: Array, strength: Array, spread: float, waveform: Waveform
) -> tuple[float | None, bool]:
    """The period that shows in the coherence of all lags, and whether it is the expected one."""
    expected, preamble = waveform.frame_length, waveform.preamble_length
    if coherence[0] < _LEAST_VARIANCE:
        return None, False
    best = float(strength.max())
    if best < max(_CLEAR * spread, 1e-6 * coherence[0]):
        return None, False
    # A tag without static paths switches the preambles themselves: its own period is a lag of still
    # higher coherence, but a longer one.
    nearby = float(strength[: 2 * expected + 1].max())
    least = max(_same(nearby, spread), _LEAST_SHARE * best)
    if expected < len(strength) and strength[expected] >= least:
        for part in range(expected // preamble, 1, -1):
            # Within a true frame nothing repeats at these lags: their coherence is zero.
            shorter = expected // part
            if expected % part == 0 and strength[shorter] >= _LEAST_SAME * strength[expected]:
                return shorter, False
        return expected, True
    first = int(np.argmax(strength >= _same(best, spread)))
    # The flank of a wide peak may be as high: the period is the highest lag nearby.
    period = first + int(np.argmax(strength[first : first + waveform.symbol_length // 8]))
    return _fraction_of(period, coherence, best, preamble), False


def _same(strength: float, spread: float) -> float:
    """Least strength of a lag that is a period as well as one of this strength."""
    return max(_SAME * strength - _NOISE * spread, _LEAST_SAME * strength)


def _fraction_of(period: int, coherence: Array, best: float, preamble: int) -> float:
    """The part of a period after which frames repeat that do not take whole samples."""
    for parts in range(period // preamble, 1, -1):
        lags = np.rint(np.arange(1, parts) * period / parts).astype(int)
        if coherence[lags].min() >= _FRACTION_SAME * best:
            return period / parts
    return period


def _likeness(samples: Array, symbol: Array) -> Array:
    """Normalised correlation of the samples with a symbol, from each of them on; 0 to 1."""
    finite = np.where(np.isfinite(samples), samples, 0).astype(np.complex64)
    length, match = len(symbol), np.abs(_correlation(finite, symbol)) ** 2
    power = np.cumsum(np.r_[0.0, finite.real.astype(float) ** 2 + finite.imag.astype(float) ** 2])
    energy = power[length:] - power[:-length]
    # Rounding leaves a little of what came before in samples of silence.
    heard = energy > 1e-12 * power[-1] / len(finite) * length
    own = float(np.sum(np.abs(symbol) ** 2))
    return np.where(heard, match / np.where(heard, energy * own, 1.0), 0.0)


def _coherence_of_lags(values: Array) -> Array:
    """Autocovariance of real values at every lag for which enough of them overlap."""
    count = len(values)
    size = _fast_length(2 * count)
    centred = values - values.mean()
    lags = count * (_LEAST_FRAMES - 1) // _LEAST_FRAMES + 1
    products = np.fft.irfft(np.abs(np.fft.rfft(centred, size)) ** 2, size)[:lags]
    return products / (count - np.arange(lags))


def _mean_frame(values: Array, period: float) -> Array:
    """Mean over the frames of a stream, at each sample of a frame."""
    starts = np.rint(np.arange(int(len(values) / period)) * period).astype(int)
    length = int(period)
    return np.mean([values[start : start + length] for start in starts], axis=0)


def _strength_of_periods(coherence: Array, preamble: int) -> tuple[Array, float]:
    """Least coherence at the multiples of every lag, and the spread of lags without signal."""
    lags = np.arange(len(coherence) // 2 + 1)
    strength = coherence[: len(lags)].copy()
    strength[:preamble] = 0
    for multiple in range(2, _MULTIPLES + 1):
        inside = lags[: (len(coherence) - 1) // multiple + 1]
        strength[inside] = np.minimum(strength[inside], coherence[inside * multiple])
    beyond = coherence[preamble:]
    return strength, _spread_of(beyond)


def _spread_without_guard(coherence: Array, waveform: Waveform) -> float:
    """Spread of the lags of symbols that follow each other without a guard.

    No lag is without signal then. What differs from one expected frame to the next is noise.
    """
    beyond, length = coherence[waveform.preamble_length :], waveform.frame_length
    if len(beyond) <= length:
        return np.inf
    return _spread_of(beyond[length:] - beyond[:-length]) / math.sqrt(2)


def _spread_of(values: Array) -> float:
    """Standard deviation, by the median."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _fast_length(least: int) -> int:
    """A power of two: transforms of other lengths may take long."""
    return 1 << (int(least) - 1).bit_length()


def repeats_every_frame(samples: Array, waveform: Waveform) -> bool:
    """Whether each expected frame holds a preamble where the one before has it.

    Returns bool: True also where another signal, a tone or a second reader, is received along with
    them.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        Some dozen frames, from any sample on.
    waveform : Waveform
        As it is expected.

    Notes
    -----
    The symbols of neighbouring frames are multiplied after correlation, which carrier offsets do
    not harm. What gives the same product at all samples of a frame is no preamble.
    """
    length = waveform.frame_length
    finite = np.where(np.isfinite(samples), samples, 0)
    match = _correlation(finite, symbol_of(waveform))
    match = whole_frames(match, length)
    if len(match) < _LEAST_FRAMES:
        return False
    product = np.abs(np.mean(match[1:] * match[:-1].conj(), axis=0))
    power = np.mean(np.abs(match) ** 2, axis=0)
    best = int(np.argmax(product))
    least = max(_PRESENT * power[best], _LOUD * power.max())
    return bool(product[best] - np.median(product) >= least)


def likeness_of_mean(samples: Array, waveform: Waveform) -> float:
    """Normalised correlation of the mean frame with the preamble, at the best cyclic shift.

    Returns float: 0 to 1; about 0.02 for noise. 0 without a whole frame of finite samples.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        As many frames as possible.
    waveform : Waveform
        As it is expected.
    """
    length = waveform.frame_length
    frames = whole_frames(samples, length)
    frames = frames[np.isfinite(frames).all(axis=1)]
    if not len(frames):
        return 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        mean = frames.mean(axis=0)
    cyclic = np.concatenate([mean, mean[: waveform.preamble_length - 1]])
    return float(_likeness(cyclic, waveform.preamble).max())


def _correlation(samples: Array, symbol: Array) -> Array:
    """Correlation of the samples with a symbol, from each of them on."""
    size = _fast_length(len(samples))
    # NumPy 2 transforms single precision in single precision.
    spectrum = np.fft.fft(samples.astype(complex), size) * np.fft.fft(symbol, size).conj()
    return np.fft.ifft(spectrum)[: len(samples) - len(symbol) + 1]
