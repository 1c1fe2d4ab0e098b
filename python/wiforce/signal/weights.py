# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that take the tag's tones out of a phase group and let nothing slower through.

A group of N snapshots is modelled as tones plus clutter, H = [E | U] x; the weights are the tone
rows of the pseudo-inverse, so that whatever lies in the span of U (the mean, or discrete prolate
spheroidal sequences of bandwidth B) does not reach the tones at all.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import InputError
from .waveform import FFT_LENGTH

# Sequences beyond 2NW that hold the leakage of clutter inside the band below -160 dB.
_EXTRA_SEQUENCES = 10
# Two tones closer than this part of the group's resolution count as one.
_SAME_TONE = 0.3
# A tone nearer to the clutter band than this part of the resolution cannot be told from it.
_CLUTTER_MARGIN = 0.75
# Noise of a tone, relative to that of a whole group, above which it is not worth having.
_WORST_GAIN = 30
_WORST_PARTIAL_GAIN = 100


@dataclass(frozen=True)
class Tone:
    """A line of the group's spectrum.

    ``owners`` lists (tag index, harmonic) of every tag line that falls on it; an aliased line
    keeps its harmonic number. ``line_hz`` is the frequency on the air, before aliasing.
    """

    frequency_hz: float
    owners: tuple
    line_hz: float


@dataclass(frozen=True)
class ToneTable:
    """Weights of a run, with what is needed to interpret and to redo them.

    Attributes
    ----------
    tones : tuple of Tone
    weights : ndarray of complex, shape (M, N)
        P_m = sum_n weights[m, n] H[n]; phases count from the group's centre snapshot
        (N - 1) / 2. Rows of opposite frequency are conjugates of each other. The values are
        exactly representable in single precision, so that a kernel in floats applies the very
        table that the mixing matrix is computed with.
    basis : ndarray of complex, shape (N, M + clutter order), or None
        Tones, then clutter; None for a plain Fourier sum over the group.
    snapshot_period_s : float
    """

    tones: tuple
    weights: np.ndarray = field(repr=False)
    basis: np.ndarray = field(repr=False)
    snapshot_period_s: float

    @property
    def group_length(self):
        return self.weights.shape[1]

    @cached_property
    def times_s(self):
        """Times of the snapshots from the group's centre; shape (N,)."""
        n = np.arange(self.group_length)
        return (n - (self.group_length - 1) / 2) * self.snapshot_period_s

    @cached_property
    def whitener(self):
        """Matrix that makes the tones' noise white: inverse Cholesky factor of W W^H."""
        return _whitener(self.weights)

    def derotation(self, sample_rate_hz):
        """Factors that stop each line's turning within a symbol, for the tones before the FFT.

        A line at f turns by 2 pi f / sample_rate from one folded sample to the next and would
        leak into the neighbouring subcarriers.

        Returns
        -------
        ndarray of complex, shape (M, 64)
        """
        offset_s = (np.arange(FFT_LENGTH) - (FFT_LENGTH - 1) / 2) / sample_rate_hz
        lines = np.array([tone.line_hz for tone in self.tones])
        return np.exp(-2j * np.pi * np.outer(lines, offset_s))

    def symbol_gain(self, sample_rate_hz):
        """What a symbol's average would take off each line, were it not derotated; shape (M,)."""
        lines = np.array([tone.line_hz for tone in self.tones])
        return np.sinc(lines * FFT_LENGTH / sample_rate_hz)

    def for_present(self, mask):
        """Weights of a group in which only some snapshots are present.

        Parameters
        ----------
        mask : ndarray of bool, shape (N,)

        Returns
        -------
        PartialWeights or None
            None when the snapshots present do not determine the tones.
        """
        if self.basis is None:
            weights = self.weights[:, mask] * (len(mask) / max(mask.sum(), 1))
            return PartialWeights(mask, weights) if mask.any() else None
        present = self.basis[mask]
        if present.shape[0] <= present.shape[1]:
            return None
        weights = _tone_rows(present, len(self.tones))
        noise_gain = np.sum(np.abs(weights) ** 2, axis=1) * self.group_length
        if noise_gain.max() > _WORST_PARTIAL_GAIN:
            return None
        return PartialWeights(mask, weights)


@dataclass(frozen=True)
class PartialWeights:
    """Exact least-squares weights over the snapshots present.

    Attributes
    ----------
    mask : ndarray of bool, shape (N,)
    weights : ndarray of complex, shape (M, count of present)
    """

    mask: np.ndarray
    weights: np.ndarray

    @cached_property
    def whitener(self):
        """As :attr:`ToneTable.whitener`."""
        return _whitener(self.weights)

    @property
    def missing(self):
        return int(len(self.mask) - self.mask.sum())


def _whitener(weights):
    return np.linalg.inv(np.linalg.cholesky(weights @ weights.conj().T))


def _tone_rows(basis, tones):
    return np.linalg.pinv(basis, rcond=1e-12)[:tones]


def clutter_order(group_length, snapshot_period_s, clutter_hz):
    """Number of sequences that :func:`clutter_basis` holds."""
    if clutter_hz == 0:
        return 1
    half_bandwidth = clutter_hz * group_length * snapshot_period_s
    return min(int(np.ceil(2 * half_bandwidth)) + _EXTRA_SEQUENCES, group_length)


def clutter_basis(group_length, snapshot_period_s, clutter_hz):
    """Orthonormal basis of everything slower than ``clutter_hz``; shape (N, order).

    0 keeps the mean only. Otherwise the first ceil(2NW) + 10 discrete prolate spheroidal
    sequences of half-bandwidth NW = B N T.
    """
    if clutter_hz == 0:
        return np.full((group_length, 1), group_length**-0.5)
    from scipy.signal.windows import dpss

    half_bandwidth = clutter_hz * group_length * snapshot_period_s
    order = clutter_order(group_length, snapshot_period_s, clutter_hz)
    # SciPy asks for NW < N/2 and NW > 0; very short groups need a floor to have sequences at all.
    return dpss(group_length, max(half_bandwidth, 0.1), order).T


def tag_lines(clocks_hz, snapshot_period_s, group_length, harmonics=8, clutter_hz=0.0):
    """Lines at which the tags are read, aliased ones included.

    Parameters
    ----------
    clocks_hz : sequence of float
        Nominal fs of each tag.
    snapshot_period_s : float
    group_length : int
    harmonics : int
        Lines +-1..+-harmonics of each tag.
    clutter_hz : float
        Lines that alias into this band are left out.

    Returns
    -------
    tuple of Tone
        Ascending in frequency; symmetric about 0.
    """
    rate = 1 / snapshot_period_s
    resolution = rate / group_length
    lines = []
    for tag, clock_hz in enumerate(clocks_hz):
        for m in range(1, harmonics + 1):
            frequency = (m * clock_hz + rate / 2) % rate - rate / 2
            sign = 1 if frequency >= 0 else -1
            near_nyquist = rate / 2 - abs(frequency) < _CLUTTER_MARGIN * resolution
            if abs(frequency) > clutter_hz + _CLUTTER_MARGIN * resolution and not near_nyquist:
                lines.append((abs(frequency), (tag, sign * m), sign * m * clock_hz))
    merged = []
    for frequency, owner, line_hz in sorted(lines):
        if merged and frequency - merged[-1].frequency_hz < _SAME_TONE * resolution:
            merged[-1] = _shared(merged[-1], owner, line_hz)
        else:
            merged.append(Tone(frequency, (owner,), line_hz))
    positive = merged
    negative = [
        Tone(-tone.frequency_hz, tuple((tag, -m) for tag, m in tone.owners), -tone.line_hz)
        for tone in positive
    ]
    return tuple(negative[::-1] + positive)


def _shared(tone, owner, line_hz):
    """A tone on which one more line falls; the slower line, the stronger, gives its frequency."""
    slower = min(tone.line_hz, line_hz, key=abs)
    return Tone(tone.frequency_hz, (*tone.owners, owner), slower)


def design_weights(
    clocks_hz, group_length, snapshot_period_s, clutter_hz=0.0, harmonics=8, rectangular=False
):
    """Weight table for the lines of all tags of a scene.

    Parameters
    ----------
    clocks_hz : sequence of float
        Nominal fs of each tag; 4 fs must lie below half the snapshot rate.
    group_length : int
        Snapshots per group, N.
    snapshot_period_s : float
    clutter_hz : float
        Highest Doppler frequency of anything that moves; 0 when nothing does.
    harmonics : int
        Lines +-1..+-harmonics are used; at least 4.
    rectangular : bool
        A plain Fourier sum over the group for every line instead, as the paper has it: clutter
        and the lines themselves leak into one another.

    Returns
    -------
    ToneTable

    Raises
    ------
    InputError
        When a clock is too fast, the clutter band reaches the first line, or the group is too
        short to tell the lines from the clutter.
    """
    _check_settings(clocks_hz, group_length, snapshot_period_s, clutter_hz, harmonics)
    tones = tag_lines(clocks_hz, snapshot_period_s, group_length, harmonics, clutter_hz)
    _check_tones(tones, clocks_hz)
    n = np.arange(group_length) - (group_length - 1) / 2
    frequencies = np.array([tone.frequency_hz for tone in tones])
    lines = np.exp(2j * np.pi * snapshot_period_s * np.outer(n, frequencies))
    if rectangular:
        weights = (lines.conj().T / group_length).astype(np.complex64).astype(complex)
        return ToneTable(tones, weights, None, snapshot_period_s)
    basis = np.hstack([lines, clutter_basis(group_length, snapshot_period_s, clutter_hz)])
    if basis.shape[0] <= basis.shape[1]:
        rule = f"must exceed the {basis.shape[1]} lines and clutter sequences of the scene"
        raise InputError("phase_group.snapshots", rule, group_length)
    weights = _tone_rows(basis, len(tones))
    # The pseudo-inverse is symmetric only to rounding; the kernels share work on exact conjugates.
    weights = (weights + weights[::-1].conj()) / 2
    weights = weights.astype(np.complex64).astype(complex)
    noise_gain = np.sum(np.abs(weights) ** 2, axis=1) * group_length
    if noise_gain.max() > _WORST_GAIN:
        rule = f"is too short to tell the lines from clutter of {clutter_hz:g} Hz"
        raise InputError("phase_group.snapshots", rule, group_length)
    return ToneTable(tones, weights, basis, snapshot_period_s)


def _check_settings(clocks_hz, group_length, snapshot_period_s, clutter_hz, harmonics):
    if not (group_length >= 1 and group_length == int(group_length)):
        raise InputError("group_length", "must be a positive integer", group_length)
    if not clutter_hz >= 0:
        raise InputError("moving_clutter_hz", "must be 0 or more", clutter_hz)
    nyquist = 0.5 / snapshot_period_s
    resolution = 1 / (group_length * snapshot_period_s)
    for clock_hz in clocks_hz:
        if not 0 < 4 * clock_hz < nyquist:
            rule = f"4 clock_hz must lie below half the snapshot rate ({nyquist:.1f} Hz)"
            raise InputError("clock_hz", rule, clock_hz)
        if clutter_hz + _CLUTTER_MARGIN * resolution >= clock_hz:
            rule = f"clutter band and group resolution must leave clock_hz = {clock_hz:g} free"
            raise InputError("moving_clutter_hz", rule, clutter_hz)
    if harmonics < 4:
        raise InputError("harmonics", "must be at least 4", harmonics)


def _check_tones(tones, clocks_hz):
    alone = {tone.owners[0][0] for tone in tones if len(tone.owners) == 1}
    for tag, clock_hz in enumerate(clocks_hz):
        if tag not in alone:
            rule = "must leave the tag a line on which no other line falls, nor an alias of its own"
            raise InputError("clock_hz", rule, clock_hz)
