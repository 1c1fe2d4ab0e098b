# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames in samples: where they begin, how often they come, how they move, and their levels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...io.capture.samples import CLIPPED
from ...signal.waveform import Waveform
from ...wiforce_kernels import COMPARED_FRAMES
from ..groups import Array

# Samples from the frame's start to the strongest path: weaker paths may arrive up to 8 samples
# earlier, and echoes up to 56 samples later stay inside the repetition that is dropped.
MARGIN = 8
# Averaging this many frames raises the preamble by 33 dB over what changes from frame to frame.
SEARCHED_FRAMES = 2000
# Samples after which longer frames are no longer averaged: 92 MB, and 2000 frames of up to 2880.
_SEARCHED_SAMPLES = 5_760_000
_FEWEST_FRAMES = 16
# Ratio of the best match to the rms match of noise that counts as a preamble. The largest of 720
# matches of Gaussian noise exceeds 4.3 times their rms once in 10^5 searches.
_CLEAR = 12.0
# The same without such matches: log likelihood of Gaussian noise against a preamble, once in 1e11.
_FALSE_ALARM = -11 * math.log(10)
# Shifts by more than a preamble and its echoes see noise only.
_ECHOES = 10
_LEAST_QUIET = 8


def whole_frames(samples: Array, frame_length: int) -> Array:
    """Samples cut into frames, (n // frame_length, frame_length); the rest is left out."""
    return samples[: len(samples) // frame_length * frame_length].reshape(-1, frame_length)


def searched_samples(waveform: Waveform) -> int:
    """Samples at the start of a stream in which frames are searched; fewer frames of long ones."""
    length = waveform.frame_length
    frames = min(SEARCHED_FRAMES, max(_FEWEST_FRAMES, _SEARCHED_SAMPLES // length))
    return frames * length


def find_frame_offset(samples: Array, waveform: Waveform) -> int | None:
    """Sample at which the first frame begins, by the mean frame; None without a preamble."""
    found = _search(samples, waveform)
    return None if found is None else (found.begin - MARGIN) % len(found.mean)


class _Found(NamedTuple):
    """A mean frame, its match at every cyclic shift, (frame_length,), and where preambles begin."""

    mean: Array
    match: Array
    begin: int


def _search(samples: Array, waveform: Waveform) -> _Found | None:
    mean = _mean_of_frames(samples, waveform.frame_length)
    if mean is None:
        return None
    match = _match(mean, waveform)
    best = int(np.argmax(match))
    if not match[best] > 0:
        return None
    if has_quiet_samples(waveform):
        # Partial overlaps match as well: only shifts without any overlap measure the noise.
        apart = waveform.preamble_length + _ECHOES + 1
        quiet = np.roll(match, -best)[apart : len(match) - apart + 1]
        clear = match[best] >= _CLEAR * np.sqrt(np.mean(quiet**2))
    else:
        clear = _noise(mean, match[best], waveform) + math.log(len(mean)) < _FALSE_ALARM
    return _Found(mean, match, best) if clear else None


def _mean_of_frames(samples: Array, frame_length: int) -> Array | None:
    """Mean frame (frame_length,) of those that are finite, without DC; None without any."""
    frames = whole_frames(samples, frame_length)
    finite = np.isfinite(frames).all(axis=1)
    if not finite.any():
        return None
    if not finite.all():
        frames = frames[finite]
    # Samples of another type read as floats may have any size.
    with np.errstate(over="ignore", invalid="ignore"):
        mean: Array = frames.mean(axis=0).astype(complex)
        mean -= mean.mean()
    return mean


def _match(frames: Array, waveform: Waveform) -> Array:
    """Correlation of frames (..., frame_length) with the sent one at every cyclic shift."""
    spectrum = np.fft.fft(frames) * np.fft.fft(waveform.frame()).conj()
    return np.abs(np.fft.ifft(spectrum))


def frame_powers(samples: Array, waveform: Waveform) -> Array:
    """Power of the preamble in each whole frame, wherever in it it begins; (n,)."""
    frames = np.nan_to_num(whole_frames(samples, waveform.frame_length))
    return _match(frames, waveform).max(axis=1, initial=0.0) ** 2


def _noise(mean: Array, match: float, waveform: Waveform) -> float:
    """Log likelihood of noise against a preamble: (1 - share of power)^(samples - 1)."""
    power = float(np.vdot(mean, mean).real) * float(np.sum(np.abs(waveform.preamble) ** 2))
    share = max(1 - match**2 / max(power, 1e-30), 1e-30)
    return (len(mean) - 1) * math.log(share)


def has_quiet_samples(waveform: Waveform) -> bool:
    """Whether the guard is long enough to tell a preamble from noise in the mean frame."""
    return waveform.frame_length - 2 * (waveform.preamble_length + _ECHOES) - 1 >= _LEAST_QUIET


def keeps_alignment(offset: int, waveform: Waveform) -> bool:
    """Whether frames cut from sample 0 hold averaged repetitions of one at ``offset``."""
    late = (offset + MARGIN) % waveform.frame_length
    return late <= waveform.prefix_length - MARGIN


def elsewhere(samples: Array, waveform: Waveform) -> int | None:
    """Sample of a frame at which preambles begin; None where that is as cut, or ambiguous."""
    found = _search(samples, waveform)
    if found is None:
        return None
    mean, match, begin = found
    if keeps_alignment((begin - MARGIN) % len(mean), waveform):
        return None
    other = np.delete(match, np.arange(begin - MARGIN, begin + MARGIN + 1) % len(match)).max()
    here, there = (_noise(mean, each, waveform) for each in (match[begin], other))
    return begin if here - there < _FALSE_ALARM else None


def symbols_in(samples: Array, waveform: Waveform) -> int:
    """Symbols that preambles of a repeated symbol hold, unless noise explains fewer."""
    sent = waveform.preamble_length // waveform.symbol_length
    repeated = np.tile(waveform.symbol, sent)
    if not np.array_equal(repeated, waveform.preamble):
        return sent
    found = _search(samples, waveform)
    if found is None:
        return sent
    mean = found.mean
    preamble = np.roll(mean, -found.begin)[: len(repeated)]
    sums = np.r_[0, np.cumsum(preamble.reshape(sent, -1) @ waveform.symbol.conj())]
    # What a part of the preamble explains, as a match of the whole one.
    match = {
        (last - first, first): abs(sums[last] - sums[first]) * math.sqrt(sent / (last - first))
        for first in range(sent)
        for last in range(first + 1, sent + 1)
    }
    count, first = max(match, key=lambda part: match[part])
    part, whole = (_noise(mean, match[each], waveform) for each in ((count, first), (sent, 0)))
    return count if part - whole < _FALSE_ALARM else sent


def frame_offset_in(samples: Array, waveform: Waveform) -> int:
    """Samples before the first frame, by the first :func:`searched_samples`; 0 if none needed."""
    offset, length = find_frame_offset(samples, waveform), waveform.frame_length
    if offset is not None and has_quiet_samples(waveform):
        # Behind a slip, most frames are elsewhere. The first ones are those that all later ones are
        # compared with.
        first = find_frame_offset(samples[: COMPARED_FRAMES * length], waveform)
        if first is not None and MARGIN < (first - offset) % length < length - MARGIN:
            offset = first
    return 0 if offset is None or keeps_alignment(offset, waveform) else offset


def describe_frames(waveform: Waveform) -> str:
    """Name the frames that are searched, for messages that say that there are none."""
    rate = f"{waveform.sample_rate_hz / 1e6:g} Msps"
    return f"waveform {waveform.name!r}, {waveform.frame_length} samples per frame at {rate}"


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
_CLEAR_PERIOD = 20.0
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


class FramePeriod(NamedTuple):
    """What the samples of a stream say of the length of its frames.

    ``samples`` is the period of the preambles, None where it does not stand out; ``agrees`` where
    the expected length is a period and no part of it is; ``likeness``, 0 to 1, is the largest mean
    over frames of the normalised correlation with the symbol, 0.1 for other signals.
    """

    samples: float | None = None
    agrees: bool = False
    likeness: float = 0.0


def samples_needed(frame_length: int) -> int:
    """Samples in which :func:`find_frame_period` can confirm a frame length."""
    return max(SEARCHED_SAMPLES, _LEAST_FRAMES * frame_length)


def find_frame_period(
    samples: Array, waveform: Waveform, symbol: Array | None = None
) -> FramePeriod:
    """Find after how many samples the preambles of a stream repeat, from some dozen frames.

    Of q, the normalised correlation of the samples with the symbol from each of them on, a period
    is a lag at which, and at whose multiples, the autocovariance is high. Level and carrier offset
    do not matter; samples lost in a gap are zeros.
    """
    if symbol is None:
        symbol = waveform.symbol
    if len(samples) < waveform.preamble_length + 2 * waveform.symbol_length:
        return FramePeriod()
    likeness = _likeness(samples, symbol)
    coherence = _coherence_of_lags(likeness)
    if len(coherence) <= waveform.preamble_length:  # too short for a lag beyond the preamble
        return FramePeriod()
    strength, spread = _strength_of_periods(coherence, waveform.preamble_length)
    period, agrees = _period_in(coherence, strength, spread, waveform)
    least = 0.0
    if period is None and waveform.frame_length < waveform.preamble_length + len(symbol):
        spread, least = min(spread, _spread_without_guard(coherence, waveform)), _LIKE_SYMBOL
        period, agrees = _period_in(coherence, strength, spread, waveform)
    if period is None:
        return FramePeriod()
    found = round(float(_mean_frame(likeness, period).max()), 6)
    return FramePeriod(period, agrees, found) if found >= least else FramePeriod()


def _period_in(
    coherence: Array, strength: Array, spread: float, waveform: Waveform
) -> tuple[float | None, bool]:
    """The period that shows in the coherence of all lags, and whether it is the expected one."""
    expected, preamble = waveform.frame_length, waveform.preamble_length
    if coherence[0] < _LEAST_VARIANCE:
        return None, False
    best = float(strength.max())
    if best < max(_CLEAR_PERIOD * spread, 1e-6 * coherence[0]):
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
    return strength, _spread_of(coherence[preamble:])


def _spread_without_guard(coherence: Array, waveform: Waveform) -> float:
    """Spread of lags without a guard, where all hold signal: by differences of expected frames."""
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
    """Whether expected frames hold preambles where those before do, beside other signals."""
    length = waveform.frame_length
    finite = np.where(np.isfinite(samples), samples, 0)
    match = _correlation(finite, waveform.symbol)
    match = whole_frames(match, length)
    if len(match) < _LEAST_FRAMES:
        return False
    product = np.abs(np.mean(match[1:] * match[:-1].conj(), axis=0))
    power = np.mean(np.abs(match) ** 2, axis=0)
    best = int(np.argmax(product))
    least = max(_PRESENT * power[best], _LOUD * power.max())
    return bool(product[best] - np.median(product) >= least)


def _correlation(samples: Array, symbol: Array) -> Array:
    """Correlation of the samples with a symbol, from each of them on."""
    # In blocks that overlap by a symbol, which stay in the cache.
    size = _fast_length(8 * len(symbol))
    step, count = size - len(symbol) + 1, len(samples) - len(symbol) + 1
    blocks = max(1, -(-count // step))
    padded = np.zeros((blocks - 1) * step + size, complex)
    # NumPy 2 transforms single precision in single precision.
    padded[: len(samples)] = samples
    spectra = np.fft.fft(np.lib.stride_tricks.sliding_window_view(padded, size)[::step])
    spectra *= np.fft.fft(symbol, size).conj()
    return np.fft.ifft(spectra)[:, :step].ravel()[: max(0, count)]


# Frames that are cut together, and every how many of them timing is measured with.
_BLOCK, _EVERY = 64, 4
# Gains of the second-order loop for the frames' position and period. Its settling time, some ten
# blocks, is short against the 72 samples that 50 ppm are in 2000 frames of 720 samples.
_POSITION_GAIN, _PERIOD_GAIN = 0.4, 0.05
# A larger offset is no drift: 100 ppm in a block of 720-sample frames are 4.6 samples.
_JUMP, _SAME_JUMP = 8.0, 2.0
_COHERENT = 0.5
_ADAPTATION = 0.01


class FrameFollower:
    """Cuts a stream into frames that keep their timing, whatever the period of the transmitter.

    Frames overlap by a sample, or leave one out; what remains of the delay cancels in a ratio of
    antennas. Timing is the phase of the product of neighbouring bins, summed over bins and frames:
    a delay of d samples rotates it by -2 pi d / L, and a common phase cancels. ``lost`` counts
    frames in known gaps, ``moved`` shifts without one.
    """

    def __init__(self, frame_length: int) -> None:
        self._length = frame_length
        self.period = float(frame_length)
        self.lost = self.moved = 0
        self._held: Array | None = None
        self._at = 0  # position of the first sample that is held
        self._next = 0.0  # position of the next frame
        self._template: Array | None = None
        self._jump: float | None = None

    def take(self, items: Array) -> Array:
        """Take I and Q of A antennas, int16 (n, 2 A); give whole frames (m L, 2 A)."""
        held = items if self._held is None else np.concatenate([self._held, items])
        frames = []
        while (found := self._cut(held, _BLOCK)) is not None:
            frames.append(found)
            self._follow(found[::_EVERY, :, :2])
            passed = max(math.floor(self._next) - 1 - self._at, 0)
            held = held[passed:]
            self._at += passed
        self._held = held.copy()
        return self._joined(frames, items.shape[1])

    def lose(self, samples: int, width: int = 2) -> Array:
        """Samples were lost behind those taken so far; give the whole frames before the gap."""
        frames = []
        held = np.empty((0, width), np.int16) if self._held is None else self._held
        while (found := self._cut(held, 1)) is not None:
            frames.append(found)
        self._at += len(held) + samples
        self._held = None
        # Frames are cut at the nearest sample, which may be the first one behind the gap.
        missed = max(math.ceil((self._at - 0.5 - self._next) / self.period), 0)
        self._next += missed * self.period
        self.lost += missed
        self._jump = None
        return self._joined(frames, width)

    def _cut(self, held: Array, count: int) -> Array | None:
        """The next frames, shape (count, L, 2 A); None where they are not there yet."""
        positions = self._next + self.period * np.arange(count)
        starts = np.rint(positions).astype(int) - self._at
        if starts[-1] + self._length > len(held):
            return None
        self._next += count * self.period
        starts = np.maximum(starts, 0)
        if starts[-1] - starts[0] == (count - 1) * self._length:  # they follow each other
            return held[starts[0] : starts[-1] + self._length].reshape(count, self._length, -1)
        return held[starts[:, None] + np.arange(self._length)]

    def _joined(self, frames: list[Array], width: int) -> Array:
        if not frames:
            return np.empty((0, width), np.int16)
        return np.concatenate([each.reshape(-1, width) for each in frames])

    def _follow(self, frames: Array) -> None:
        product = _neighbours(frames)
        energy = float(np.vdot(product, product).real)
        if not energy > 0:
            return
        if self._template is None:
            self._template = product
            return
        template = self._template
        match = np.vdot(template, product)
        if abs(match) < _COHERENT * math.sqrt(energy * float(np.vdot(template, template).real)):
            return
        turn = 2 * math.pi / self._length
        late = -float(np.angle(match)) / turn
        if abs(late) > _JUMP:
            if self._jump is None or abs(late - self._jump) > _SAME_JUMP:
                self._jump = late
                return
            self._next += late
            self.moved += 1
            self._jump = None
            return
        self._jump = None
        self._next += _POSITION_GAIN * late
        self.period += _PERIOD_GAIN * late / _BLOCK
        self._template = template + _ADAPTATION * (product * np.exp(1j * turn * late) - template)


def _neighbours(frames: Array) -> Array:
    """Products of neighbouring bins, summed over frames of shape (n, L, 2)."""
    values = frames[..., 0] + 1j * frames[..., 1]
    values -= values.mean(axis=1, keepdims=True)
    spectra = np.fft.fft(values)
    return np.sum(spectra[:, 1:] * spectra[:, :-1].conj(), axis=0)


# Samples after the preamble that may hold echoes: 1.9 us at 12.5 Msps, 580 m of path.
_LATE_ECHOES = 24
# Frames from which phase noise is estimated, and how far it must exceed other noise.
_PHASE_NOISE_FRAMES, _VISIBLE = 512, 1.5


@dataclass(frozen=True)
class Levels:
    """Levels of received samples, relative to full scale."""

    peak_dbfs: float  # largest real or imaginary part
    preamble_dbfs: float  # mean power of a preamble
    noise_dbfs: float | None  # mean power in the guard without its mean frame
    dc_dbfs: float  # of the mean sample of the guard, or of all samples without a guard
    clipped: float  # share of the samples at full scale, or at a lower limit
    # Density of the phase of the static path in the snapshots, up to half their rate, relative to
    # its power; None where it is hidden by other noise or the frames are few.
    phase_noise_dbc_hz: float | None = None


def measure_levels(samples: Array, waveform: Waveform) -> Levels:
    """Measure the levels of samples that begin with a frame; full scale is 1 per component."""
    length, preamble = waveform.frame_length, waveform.preamble_length
    end, averaged = MARGIN + preamble, waveform.repetitions * waveform.symbol_length
    # In double precision, in which the squares of the largest floats are finite.
    frames = whole_frames(samples, length).astype(np.complex128)
    parts = np.abs(frames.real), np.abs(frames.imag)
    limit = CLIPPED * _limit(frames[:, end - averaged : end])
    clipped = np.mean((parts[0] >= limit) | (parts[1] >= limit))
    guard = frames[:, preamble + MARGIN + _LATE_ECHOES : length - MARGIN]
    quiet = guard if guard.size else frames
    # Static samples in the guard (late echoes, DC offset) are not noise.
    noise = np.mean(np.abs(guard - guard.mean(axis=0)) ** 2) if guard.size else None
    return Levels(
        peak_dbfs=_db(max(part.max() for part in parts) ** 2),
        preamble_dbfs=_db(np.mean(np.abs(frames[:, MARGIN:end]) ** 2)),
        noise_dbfs=None if noise is None else _db(noise),
        dc_dbfs=_db(np.abs(quiet.mean()) ** 2),
        clipped=float(clipped),
        phase_noise_dbc_hz=_phase_noise_dbc_hz(frames[:, :end][:, -averaged:], waveform),
    )


def _limit(averaged: Array) -> float:
    """Magnitude that no sample of frames (n, L) passes: where noise reaches all but the largest."""
    parts = np.abs(np.stack([averaged.real, averaged.imag]))
    constant, largest = np.ptp(parts, axis=1) == 0, parts.max()
    limited = parts[:, 0] >= CLIPPED * largest
    return float(largest) if constant.any() and limited[constant].all() else 1.0


def _phase_noise_dbc_hz(averaged: Array, waveform: Waveform) -> float | None:
    """Phase noise of projections (n,) on the mean: imaginary less real part, medians of f."""
    count = len(averaged)
    mean = averaged.mean(axis=0)
    energy = np.vdot(mean, mean).real
    if count < _PHASE_NOISE_FRAMES or energy < count * np.finfo(np.float32).tiny:
        return None
    projected = averaged @ mean.conj() / energy
    window = np.hanning(count)
    spectra = np.abs(np.fft.rfft([window * projected.real, window * projected.imag])) ** 2
    other, phase = np.median(spectra[:, count // 16 :], axis=1)
    if phase < _VISIBLE * other:
        return None
    # The median of a chi-squared of two degrees of freedom is ln 2 of its mean.
    scale = waveform.snapshot_period_s / np.sum(window**2) / np.log(2)
    return _db((phase - other) * scale)


def _db(power: float) -> float:
    return float(10 * np.log10(max(power, 1e-30)))
