# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that extract the tags' tones from a phase group and reject everything slower.

A group of N snapshots is modelled as tones plus clutter, H = [E | U] x. The weights are the tone
rows of the pseudo-inverse, so that whatever lies in the span of U (the mean, or discrete prolate
spheroidal sequences, see :mod:`.clutter`) does not reach the tones at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import InputError
from .clutter import clutter_basis
from .lines import CLUTTER_MARGIN, Tone, centered_times_s, tag_lines
from .partial_weights import (
    WORST_PARTIAL_GAIN,
    PartialSolver,
    PartialWeights,
    pseudo_inverse,
    whitener_of,
)
from .room_noise import RoomNoise

# Noise of a tone, relative to that of a Fourier sum over the whole group, above which a scene is
# refused (15 dB).
WORST_GAIN = 30


@dataclass(frozen=True)
class ToneTable:
    """Weights of a run, with what is needed to interpret them and to redo them for gaps.

    Attributes
    ----------
    tones : tuple of Tone, length M
        Ascending in frequency, symmetric about 0.
    weights : ndarray of complex, shape (M, N)
        P_m = sum_n weights[m, n] H[n]; phases count from the group's centre snapshot
        (N - 1) / 2. Rows of opposite frequency are conjugates of each other. The values are
        exactly representable in single precision, so that a kernel in floats applies the very
        table that the mixing matrix is computed with.
    basis : ndarray of complex, shape (N, M + clutter order), or None
        Tones, then clutter; None for a plain Fourier sum over the group.
    snapshot_period_s : float
        T, in s.
    room : RoomNoise or None
        Noise that the weights suppress; None where it is white.
    """

    tones: tuple[Tone, ...]
    weights: np.ndarray = field(repr=False)
    basis: np.ndarray | None = field(repr=False)
    snapshot_period_s: float
    room: RoomNoise | None = None

    @property
    def group_length(self) -> int:
        """Snapshots per phase group, N."""
        return self.weights.shape[1]

    @property
    def group_period_s(self) -> float:
        """Length of a phase group, N T, in s."""
        return self.group_length * self.snapshot_period_s

    @cached_property
    def times_s(self) -> np.ndarray:
        """Times of the snapshots from the group's centre, in s; shape (N,)."""
        return centered_times_s(self.group_length, self.snapshot_period_s)

    @cached_property
    def whitener(self) -> np.ndarray:
        """Matrix that makes the tones' noise white; complex, shape (M, M).

        The inverse Cholesky factor of W C W^H, C being the covariance of the noise.
        """
        return whitener_of(self.weights, self.room.covariance() if self.room else None)

    def derotation(self, sample_rate_hz: float, symbol_length: int = 64) -> np.ndarray:
        """Factors that undo each line's rotation within a symbol, applied before the FFT.

        A line at f rotates by 2 pi f / sample_rate from one folded sample to the next and would
        leak into the neighbouring subcarriers.

        Returns ndarray of complex, shape (M, symbol_length).

        Parameters
        ----------
        sample_rate_hz : float
            In Hz.
        symbol_length : int
            Samples of the symbol (``Waveform.symbol_length``).
        """
        offset_s = centered_times_s(symbol_length, 1 / sample_rate_hz)
        return np.exp(-2j * np.pi * np.outer(self._lines_hz, offset_s))

    def symbol_gain(self, sample_rate_hz: float, symbol_length: int = 64) -> np.ndarray:
        """Amplitude that the average over a symbol leaves of each line without derotation.

        Returns ndarray of float, shape (M,): sinc(symbol_length f / sample_rate), 1 at best.

        Parameters
        ----------
        sample_rate_hz : float
            In Hz.
        symbol_length : int
            Samples of the symbol.
        """
        return np.sinc(self._lines_hz * symbol_length / sample_rate_hz)

    @cached_property
    def _lines_hz(self) -> np.ndarray:
        return np.array([tone.line_hz for tone in self.tones])

    def for_present(self, mask: np.ndarray) -> PartialWeights | None:
        """Weights of a group in which only some snapshots are present.

        Returns PartialWeights or None: None when the snapshots present do not determine the tones.

        Parameters
        ----------
        mask : ndarray of bool, shape (N,)
            True where a snapshot is present.
        """
        if self.basis is None:
            weights = self.weights[:, mask] * (len(mask) / max(mask.sum(), 1))
            return PartialWeights(mask, weights) if mask.any() else None
        if self.room is None:
            return self._solver.solve(mask)
        present = self.basis[mask]
        if present.shape[0] <= present.shape[1]:
            return None
        covariance = self.room.covariance(mask)
        weights = _tone_rows(present, len(self.tones), covariance)
        noise_gain = np.sum(np.abs(weights) ** 2, axis=1) * self.group_length
        if noise_gain.max() > WORST_PARTIAL_GAIN:
            return None
        return PartialWeights(mask, weights, covariance)

    @cached_property
    def _solver(self) -> PartialSolver:
        if self.basis is None:
            raise ValueError("a Fourier sum has nothing to solve")
        return PartialSolver(self.basis, len(self.tones))


def _tone_rows(basis: np.ndarray, tones: int, covariance: np.ndarray | None = None) -> np.ndarray:
    """Rows of the (generalised, with a covariance) least-squares solution that are tones."""
    if covariance is None:
        return pseudo_inverse(basis)[:tones]
    factor = np.linalg.cholesky(covariance)
    rows = pseudo_inverse(np.linalg.solve(factor, basis))[:tones]
    return np.linalg.solve(factor.T, rows.T).T


def design_weights(
    clocks_hz: Sequence[float],
    group_length: int,
    snapshot_period_s: float,
    clutter_hz: float = 0.0,
    harmonics: int = 8,
    rectangular: bool = False,
    room: RoomNoise | None = None,
) -> ToneTable:
    """Weight table for the lines of all tags of a scene.

    Parameters
    ----------
    clocks_hz : sequence of float, length S
        Nominal fs of each tag, in Hz; 4 fs must lie below half the snapshot rate.
    group_length : int
        Snapshots per group, N.
    snapshot_period_s : float
        T, in s.
    clutter_hz : float
        Highest Doppler frequency of anything that moves; 0 when nothing does.
    harmonics : int
        Lines +-1..+-harmonics are used; at least 4.
    rectangular : bool
        A plain Fourier sum over the group for every line instead, as in the WiForce paper:
        clutter and the lines themselves then leak into one another.
    room : RoomNoise, optional
        Disturbances between the lines, which the weights then suppress as far as this does not
        cost more than it gains.

    Raises
    ------
    InputError
        When a clock is too fast, the clutter band reaches the first line, or the group is too
        short to separate the lines from each other and from clutter.
    """
    _check_settings(clocks_hz, group_length, snapshot_period_s, clutter_hz, harmonics)
    tones = tag_lines(clocks_hz, snapshot_period_s, group_length, harmonics, clutter_hz)
    _check_tones(tones, clocks_hz)
    n = centered_times_s(group_length, 1.0)
    frequencies = np.array([tone.frequency_hz for tone in tones])
    lines = np.exp(2j * np.pi * snapshot_period_s * np.outer(n, frequencies))
    if rectangular:
        weights = (lines.conj().T / group_length).astype(np.complex64).astype(complex)
        return ToneTable(tones, weights, None, snapshot_period_s)
    basis = np.hstack([lines, clutter_basis(group_length, snapshot_period_s, clutter_hz)])
    if basis.shape[0] <= basis.shape[1]:
        rule = f"must exceed the {basis.shape[1]} lines and clutter sequences of the scene"
        raise InputError("group_length", rule, group_length)
    weights = _tone_rows(basis, len(tones), room.covariance() if room else None)
    # The pseudo-inverse is symmetric only to rounding; the kernels share work on exact conjugates.
    weights = (weights + weights[::-1].conj()) / 2
    weights = weights.astype(np.complex64).astype(complex)
    noise_gain = np.sum(np.abs(weights) ** 2, axis=1) * group_length
    # With a room, tones that it disturbs may be noisy: they count for less.
    if room is None and noise_gain.max() > WORST_GAIN:
        rule = f"is too short to separate the lines from clutter of {clutter_hz:g} Hz"
        raise InputError("group_length", rule, group_length)
    return ToneTable(tones, weights, basis, snapshot_period_s, room)


def _check_settings(
    clocks_hz: Sequence[float],
    group_length: int,
    snapshot_period_s: float,
    clutter_hz: float,
    harmonics: int,
) -> None:
    if not (group_length >= 1 and group_length == int(group_length)):
        raise InputError("group_length", "must be a positive integer", group_length)
    if not clutter_hz >= 0:
        raise InputError("clutter_hz", "must be 0 or more", clutter_hz)
    nyquist = 0.5 / snapshot_period_s
    resolution = 1 / (group_length * snapshot_period_s)
    for tag, clock_hz in enumerate(clocks_hz):
        if not 0 < 4 * clock_hz < nyquist:
            rule = (
                f"must be above 0, and 4 times it below half the snapshot rate ({nyquist:.1f} Hz)"
            )
            raise InputError(f"clocks_hz[{tag}]", rule, clock_hz)
        margin = CLUTTER_MARGIN * resolution
        if clock_hz <= margin:
            rule = f"must exceed {margin:.3g} Hz for groups of {group_length} snapshots"
            raise InputError(f"clocks_hz[{tag}]", rule, clock_hz)
        if clutter_hz + margin >= clock_hz:
            rule = f"must lie more than {margin:.3g} Hz below every clock (here {clock_hz:g} Hz)"
            raise InputError("clutter_hz", rule, clutter_hz)
    if harmonics < 4:
        raise InputError("harmonics", "must be at least 4", harmonics)


def _check_tones(tones: Sequence[Tone], clocks_hz: Sequence[float]) -> None:
    alone = {tone.owners[0][0] for tone in tones if len(tone.owners) == 1}
    for tag, clock_hz in enumerate(clocks_hz):
        if tag not in alone:
            rule = "must leave the tag a line on which no other line falls, nor an alias of its own"
            raise InputError(f"clocks_hz[{tag}]", rule, clock_hz)
