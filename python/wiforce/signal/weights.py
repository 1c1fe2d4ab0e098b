# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that extract the tags' tones from a phase group and reject everything slower.

A group of N snapshots is modelled as tones plus clutter, H = [E | U] x. The weights are the tone
rows of the pseudo-inverse, so that whatever lies in the span of U (the mean, or discrete prolate
spheroidal sequences, see :mod:`.clutter`) does not reach the tones at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from .lines import CLUTTER_MARGIN, RoomNoise, Tone, centered_times_s, clutter_basis, tag_lines

# Noise of a tone, relative to that of a Fourier sum over the whole group, above which an incomplete
# group is discarded (40 dB). The whitening allows for a weak tone, so that a few of many do no
# harm; ends that cannot be separated are found by their own gain (estimation.least_squares).
WORST_PARTIAL_GAIN = 1e4
# Smallest pivot of the normal equations, whose columns have unit norm over the whole group, below
# which their solution is refined once, and below which a singular value decomposition replaces
# them. They lose the square of the condition: at the latter half of the digits.
_REFINED_PIVOT = 1e-3
# Singular values below this part of the largest are those of columns that depend on others.
_SINGULAR = 1e-12
_LEAST_PIVOT = 1e-8


@dataclass(frozen=True, eq=False, repr=False)
class PartialWeights:
    """Exact least-squares weights over the snapshots present in a group."""

    times_s: np.ndarray  # (n,), of these snapshots from the group's centre
    parts: np.ndarray  # (M, n), as :attr:`ToneTable.parts`
    # Of the noise of these snapshots; None where it is white.
    covariance: np.ndarray | None = None

    @property
    def weights(self) -> np.ndarray:
        """Weights (M, n) of the tones, as those of :class:`ToneTable`."""
        return _of_parts(self.parts)

    @cached_property
    def whitener(self) -> np.ndarray:
        """As :attr:`ToneTable.whitener`."""
        return _whitener_of(self.parts, self.covariance)

    def apply(self, snapshots: np.ndarray) -> np.ndarray:
        """Tones of a group from the snapshots present, as :func:`tones_of`."""
        return _tones(self.parts, snapshots)


def tones_of(weights: np.ndarray, snapshots: np.ndarray) -> np.ndarray:
    """``weights @ snapshots``, (M, n); conjugate rows of opposite frequency share products."""
    return _tones(parts_of(weights), snapshots)


def _tones(parts: np.ndarray, snapshots: np.ndarray) -> np.ndarray:
    """Tones (M, K) of snapshots (n, K), by the parts (M, n) of their weights."""
    samples = np.ascontiguousarray(snapshots, complex).view(float)
    return _of_parts((parts @ samples).view(complex))


def parts_of(weights: np.ndarray) -> np.ndarray:
    """Real and imaginary parts (M, n), in turns, of weights (M, n) of positive frequencies."""
    upper = weights[len(weights) // 2 :]
    return np.stack([upper.real, upper.imag], axis=1).reshape(weights.shape)


def parts_of_waves(rows: np.ndarray) -> np.ndarray:
    """Parts (M, n) of the weights of tones, from half of those of cosines and then of sines."""
    parts = np.empty_like(rows)
    half = len(rows) // 2
    parts[::2], parts[1::2] = rows[:half], -rows[half:]
    return parts


def _of_parts(parts: np.ndarray) -> np.ndarray:
    """Rows of all tones, from their parts (M, n)."""
    first, second = parts[::2], 1j * parts[1::2]
    return np.vstack([(first - second)[::-1], first + second])


def _whitener_of(parts: np.ndarray, covariance: np.ndarray | None) -> np.ndarray:
    """Inverse Cholesky factor (M, M) of W C W^T, of parts W (M, n) and the noise's covariance C."""
    colored = parts if covariance is None else parts @ covariance
    return np.linalg.inv(np.linalg.cholesky(colored @ parts.T))


def noise_gain(parts: np.ndarray) -> np.ndarray:
    """Variance of each tone of positive frequency over that of a snapshot."""
    gain: np.ndarray = np.sum(parts**2, axis=1).reshape(-1, 2).sum(axis=1)
    return gain


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Pseudo-inverse (n, m), by gesvd where gesdd of OpenBLAS 0.3.21 does not converge."""
    try:
        return np.linalg.pinv(matrix, rcond=_SINGULAR)
    except (np.linalg.LinAlgError, SystemError):
        from scipy.linalg import svd  # hardly ever needed, and slow to import

        left, sizes, right = svd(matrix, full_matrices=False, lapack_driver="gesvd")
        kept = sizes > _SINGULAR * sizes[0]
        inverse: np.ndarray = (right[kept].conj().T / sizes[kept]) @ left[:, kept].conj().T
        return inverse


# Noise of a tone, relative to that of a Fourier sum over the whole group, above which a scene is
# refused (15 dB).
WORST_GAIN = 30


@dataclass(frozen=True, eq=False, repr=False)
class ToneTable:
    """Weights of a run, with what is needed to interpret them and to redo them for gaps.

    P_m = sum_n weights[m, n] H[n], with phases from the group's centre snapshot; opposite rows are
    conjugates. The values are those of single precision, as the kernels apply them.
    """

    tones: tuple[Tone, ...]  # ascending in frequency, symmetric about 0
    weights: np.ndarray  # (M, N), complex
    # (N, M + clutter order): tones, then clutter; None for a plain Fourier sum
    basis: np.ndarray | None
    snapshot_period_s: float
    room: RoomNoise | None = None  # noise that the weights suppress; None where it is white

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
        """Inverse Cholesky factor (M, M) of W C W^T, C being the covariance of the noise."""
        return _whitener_of(self.parts, self.room.covariance() if self.room else None)

    @property
    def parts(self) -> np.ndarray:
        """Real parts (M, N) of the weights (:func:`parts_of`)."""
        return parts_of(self.weights)

    def derotation(self, sample_rate_hz: float, symbol_length: int = 64) -> np.ndarray:
        """Factors (M, symbol_length) that undo each line's 2 pi f / sample_rate per sample."""
        offset_s = centered_times_s(symbol_length, 1 / sample_rate_hz)
        return np.exp(-2j * np.pi * np.outer(self._lines_hz, offset_s))

    def symbol_gain(self, sample_rate_hz: float, symbol_length: int = 64) -> np.ndarray:
        """Amplitude (M,) that averages over a symbol leave of lines without derotation, by sinc."""
        return np.sinc(self._lines_hz * symbol_length / sample_rate_hz)

    @cached_property
    def _lines_hz(self) -> np.ndarray:
        return np.array([tone.line_hz for tone in self.tones])

    def for_present(self, mask: np.ndarray) -> PartialWeights | None:
        """Weights of a group with the snapshots of ``mask``; None if they do not suffice."""
        count, covariance = int(np.count_nonzero(mask)), None
        if count <= (0 if self.basis is None else self.basis.shape[1]):
            return None
        try:
            if self.basis is None:
                parts = self.parts[:, mask] * (len(mask) / count)
            elif self.room is None:
                parts = parts_of_waves(self._rows(mask) / 2)
            else:
                covariance = self.room.covariance(mask)
                parts = _tone_parts(self.basis[mask], len(self.tones), covariance)
        except np.linalg.LinAlgError:
            return None  # LAPACK may give up on a basis that is nearly singular
        if noise_gain(parts).max() * self.group_length > WORST_PARTIAL_GAIN:
            return None
        return PartialWeights(self.times_s[mask], parts, covariance)

    def _rows(self, mask: np.ndarray) -> np.ndarray:
        """The rows of the pseudo-inverse over some snapshots that belong to cosines and sines."""
        columns, gram, norms = self._unit_columns
        present, absent, tones = columns[mask], columns[~mask], len(self.tones)
        gram = gram - absent.T @ absent if len(absent) < len(present) else present.T @ present
        try:
            factor = np.linalg.cholesky(gram)
            pivot = float(np.min(factor.diagonal())) ** 2
        except np.linalg.LinAlgError:
            pivot = 0.0
        if pivot < _LEAST_PIVOT:
            rows = pseudo_inverse(present)[:tones]
        else:
            inverse = np.linalg.inv(factor)
            solver = inverse.T @ inverse
            rows = solver[:tones] @ present.T
            if pivot < _REFINED_PIVOT:
                rows += (np.eye(tones, len(gram)) - rows @ present) @ solver @ present.T
        return rows / norms[:tones, None]

    @cached_property
    def _unit_columns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns of the basis (N, M + clutter order) of norm 1, their products and norms."""
        assert self.basis is not None
        columns = _real_columns(self.basis, len(self.tones))
        norms = np.linalg.norm(columns, axis=0)
        return columns / norms, columns.T @ columns / np.outer(norms, norms), norms


def _real_columns(basis: np.ndarray, tones: int) -> np.ndarray:
    """Cosines and sines instead of opposite tones, the same in real numbers, then clutter."""
    upper = basis[:, tones // 2 : tones]
    return np.hstack([upper.real, upper.imag, basis[:, tones:].real])


def _tone_parts(basis: np.ndarray, tones: int, covariance: np.ndarray | None) -> np.ndarray:
    """Parts (M, n) of the tones in the (generalised, with a covariance) least-squares solution."""
    columns = _real_columns(basis, tones)
    if covariance is None:
        rows = pseudo_inverse(columns)[:tones]
    else:
        factor = np.linalg.cholesky(covariance)
        rows = pseudo_inverse(np.linalg.solve(factor, columns))[:tones]
        rows = np.linalg.solve(factor.T, rows.T).T
    return parts_of_waves(rows / 2)


def design_weights(
    clocks_hz: Sequence[float],
    group_length: int,
    snapshot_period_s: float,
    clutter_hz: float = 0.0,
    harmonics: int = 8,
    rectangular: bool = False,
    room: RoomNoise | None = None,
) -> ToneTable:
    """Weight table for the lines +-1..+-``harmonics``, at least 4, of all tags of a scene.

    For groups of N snapshots of period T, with what moves up to ``clutter_hz``; disturbances of
    ``room`` are suppressed as far as that gains. ``rectangular``: a plain Fourier sum, as in the
    paper. Refused when 4 fs exceeds half the snapshot rate, clutter reaches the first line, or the
    group is too short.
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
    weights = _of_parts(_tone_parts(basis, len(tones), room.covariance() if room else None))
    weights = weights.astype(np.complex64).astype(complex)
    # With a room, tones that it disturbs may be noisy: they count for less.
    if room is None and noise_gain(parts_of(weights)).max() * group_length > WORST_GAIN:
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
