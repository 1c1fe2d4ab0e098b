# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that extract the tags' tones from a phase group and reject everything slower.

A group of N snapshots is modelled as tones plus clutter, H = [E | U] x. The weights are the tone
rows of the pseudo-inverse, so that whatever lies in the span of U (the mean, or prolate spheroidal
sequences) does not reach the tones at all. Frames that follow each other have weights for a whole
run; packets have times of their own, at which each group is solved by least squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre

from ..errors import InputError
from .lines import (
    CLUTTER_MARGIN,
    RoomNoise,
    Tone,
    centered_times_s,
    clutter_basis,
    tag_lines,
    with_mirrors,
)

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
        """Tones (M, K) of a group from the snapshots (n, K) that are present."""
        # Conjugate rows of opposite frequency share products.
        samples = np.ascontiguousarray(snapshots, complex).view(float)
        return _of_parts((self.parts @ samples).view(complex))


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
    times_s: np.ndarray  # (N,), of the snapshots from the group's centre
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
    _check_tones(tones, clocks_hz, "on which no other line falls, nor an alias of its own")
    n = centered_times_s(group_length, 1.0)
    grid = snapshot_period_s, centered_times_s(group_length, snapshot_period_s)
    frequencies = np.array([tone.frequency_hz for tone in tones])
    lines = np.exp(2j * np.pi * snapshot_period_s * np.outer(n, frequencies))
    if rectangular:
        weights = (lines.conj().T / group_length).astype(np.complex64).astype(complex)
        return ToneTable(tones, weights, None, *grid)
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
    return ToneTable(tones, weights, basis, *grid, room)


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


def _check_tones(tones: Sequence[Tone], clocks_hz: Sequence[float], line: str) -> None:
    alone = {tone.owners[0][0] for tone in tones if len(tone.owners) == 1}
    for tag, clock_hz in enumerate(clocks_hz):
        if tag not in alone:
            raise InputError(f"clocks_hz[{tag}]", f"must leave the tag a line {line}", clock_hz)


# Lines of packets whose correlation over the times exceeds the first are one tone: sinc(0.3), as on
# a grid (lines.py). A line is left out where its correlation with its own mirror image, or the
# share of it that is clutter, exceeds the others: half of it can then not be distinguished.
_SAME_TONE = 0.86
_OWN_MIRROR = 0.7
_CLUTTER_SHARE = 0.5
# Sequences beyond 2BT: what remains of clutter is 60 to 100 dB down, as much as channel estimates
# of 10 to 16 bits resolve.
_EXTRA_SEQUENCES = 8
# Condition of the basis beyond which tones count as undetermined; half of the digits remain.
_WORST_CONDITION = 1e6

# Weights, and an orthonormal basis (columns, n) of what is solved for.
_Fit = tuple[PartialWeights, np.ndarray]


@dataclass(frozen=True, eq=False, repr=False)
class TimedTable(ToneTable):
    """Weights of groups with times of their own: those of a typical one.

    Lines do not alias here, unless packets are regular: two lines are one tone where these times do
    not distinguish them.
    """

    clutter_hz: float = 0.0

    def at(self, times_s: np.ndarray, states: np.ndarray) -> PartialWeights | None:
        """Weights at times (n,) from the centre, a constant per state; None if undetermined."""
        fit = self._fit(times_s, states)
        return None if fit is None else fit[0]

    def tone_noise(
        self, times_s: np.ndarray, channel: np.ndarray, states: np.ndarray
    ) -> float | None:
        """Variance of the tones by what is unexplained of a channel (n, K), or None."""
        fit = self._fit(times_s, states)
        if fit is None:
            return None
        weights, basis = fit
        power = np.sum(np.abs(channel) ** 2)
        # Parts by themselves: complex channels would make the basis complex.
        explained = np.sum((basis @ channel.real) ** 2) + np.sum((basis @ channel.imag) ** 2)
        freedom = (len(times_s) - len(basis)) * channel.shape[1]
        return float(noise_gain(weights.parts).mean() * (power - explained) / max(freedom, 1))

    def beside(
        self, times_s: np.ndarray, states: np.ndarray, shifts_hz: Sequence[float]
    ) -> list[PartialWeights]:
        """Weights of tones at these shifts from these here, solved for together with these.

        Orthogonal to all that is solved for here, they are those of the larger least squares
        (Frisch and Waugh). Shifts at which they are undetermined are left out.
        """
        fit = self._fit(times_s, states)
        if fit is None:
            return []
        _, basis = fit
        upper = np.array([tone.frequency_hz for tone in self.tones if tone.frequency_hz > 0])
        found = []
        for shift_hz in shifts_hz:
            phases = 2 * np.pi * np.outer(times_s, upper + shift_hz)
            waves = np.hstack([np.cos(phases), np.sin(phases)])
            rest = self._solved(times_s, waves - basis.T @ (basis @ waves), len(basis))
            if rest is not None:
                found.append(rest[0])
        return found

    def _fit(self, times_s: np.ndarray, states: np.ndarray) -> _Fit | None:
        """Least squares at these times; None when they do not determine the tones."""
        upper = [tone.frequency_hz for tone in self.tones if tone.frequency_hz > 0]
        phases = 2 * np.pi * np.outer(times_s, upper)
        clutter = clutter_at(times_s, self.group_period_s, self.clutter_hz)
        # The constant of the first state is in the clutter.
        constants = [(states == state)[:, None] for state in np.unique(states)[1:]]
        return self._solved(
            times_s, np.hstack([np.cos(phases), np.sin(phases), clutter, *constants])
        )

    def _solved(self, times_s: np.ndarray, columns: np.ndarray, others: int = 0) -> _Fit | None:
        """Least squares of columns (n, m), tones first, orthogonal to ``others`` solved for."""
        tones = len(self.tones)
        if not tones or len(columns) <= columns.shape[1] + others:
            return None
        scale = 1 / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        orthogonal, triangle = np.linalg.qr(columns * scale)
        sizes = np.linalg.svd(triangle, compute_uv=False)
        if not sizes[-1] * _WORST_CONDITION > sizes[0]:
            return None
        # Rows of the pseudo-inverse that are cosines, then sines.
        rows = np.linalg.inv(triangle)[:tones] * scale[:tones, None] @ orthogonal.T
        parts = parts_of_waves(rows / 2)
        if noise_gain(parts).max() * len(times_s) > WORST_PARTIAL_GAIN:
            return None
        return PartialWeights(times_s, parts), orthogonal.T


def timed_table(
    clocks_hz: Sequence[float],
    times_s: np.ndarray,
    period_s: float,
    clutter_hz: float = 0.0,
    harmonics: int = 8,
) -> TimedTable:
    """:func:`design_weights` at the times (N,) of a typical group from its centre."""
    tones = timed_lines(clocks_hz, times_s, period_s, clutter_hz, harmonics)
    empty = np.zeros((len(tones), len(times_s)), complex)
    interval_s = period_s / len(times_s)
    table = TimedTable(tones, empty, None, interval_s, times_s, clutter_hz=clutter_hz)
    found = table.at(times_s, np.zeros(len(times_s), int))
    if found is None:
        rule = (
            f"must be longer: its {len(times_s)} packets do not determine {len(tones)} lines of "
            f"the tags beside clutter of {clutter_hz:g} Hz"
        )
        raise InputError("group_length", rule, len(times_s))
    _check_tones(tones, clocks_hz, "that these packets distinguish from every other")
    return replace(table, weights=found.weights)


def timed_lines(
    clocks_hz: Sequence[float],
    times_s: np.ndarray,
    period_s: float,
    clutter_hz: float = 0.0,
    harmonics: int = 8,
) -> tuple[Tone, ...]:
    """Tones of :func:`timed_table`, ascending in frequency and symmetric about 0."""
    clutter, _ = np.linalg.qr(clutter_at(times_s, period_s, clutter_hz))
    lines = sorted(
        (m, m * clock_hz, tag)
        for m in range(1, harmonics + 1)
        for tag, clock_hz in enumerate(clocks_hz)
    )
    frequencies = [hertz for _, hertz, _ in lines]
    waves = np.exp(2j * np.pi * np.outer(frequencies, times_s)) / np.sqrt(len(times_s))
    slow = np.sum(np.abs(waves @ clutter) ** 2, axis=1)
    same, mirrored = np.abs(waves @ waves.conj().T), np.abs(waves @ waves.T)
    left_out = (slow > _CLUTTER_SHARE) | (np.diag(mirrored) > _OWN_MIRROR)
    alike = np.maximum(same, mirrored) > _SAME_TONE
    owners: dict[int, list[tuple[int, int]]] = {}
    # The slowest lines first: they are the strongest, and give a shared tone its frequency.
    for row in map(int, np.flatnonzero(~left_out)):
        m, _, tag = lines[row]
        tone = next((other for other in np.flatnonzero(alike[row]) if other in owners), row)
        mirror = mirrored[row, tone] > same[row, tone]
        owners.setdefault(tone, []).append((tag, -m if mirror else m))
    tones = sorted((frequencies[row], tuple(of)) for row, of in owners.items())
    return with_mirrors([Tone(hertz, of, hertz) for hertz, of in tones])


def clutter_at(times_s: np.ndarray, period_s: float, clutter_hz: float) -> np.ndarray:
    """Basis (n, order) of everything slower than B = ``clutter_hz`` at times from the centre.

    Prolate spheroidal wave functions in Legendre polynomials (H. Xiao, V. Rokhlin, N. Yarvin,
    Inverse Problems 17 (2001), section 4), whose samples on a grid are those of
    :func:`.clutter_basis`; not orthogonal here. The constant for B = 0.
    """
    if clutter_hz == 0:
        return np.ones((len(times_s), 1))
    order = int(np.ceil(2 * clutter_hz * period_s)) + _EXTRA_SEQUENCES
    expansion = _prolate_functions(np.pi * clutter_hz * period_s, order)
    return legendre.legvander(2 * times_s / period_s, len(expansion) - 1) @ expansion


@lru_cache
def _prolate_functions(band: float, order: int) -> np.ndarray:
    """Legendre coefficients of the first prolate functions of a band limit c; (terms, order)."""
    k = np.arange(2 * order + int(2 * band) + 30, dtype=float)
    diagonal = k * (k + 1) + (2 * k * (k + 1) - 1) / ((2 * k + 3) * (2 * k - 1)) * band**2
    j = k[:-2]
    beside = (j + 2) * (j + 1) / ((2 * j + 3) * np.sqrt((2 * j + 1) * (2 * j + 5))) * band**2
    matrix = np.diag(diagonal) + np.diag(beside, 2) + np.diag(beside, -2)
    _, functions = np.linalg.eigh(matrix)
    normalised: np.ndarray = functions[:, :order] * np.sqrt(k + 0.5)[:, None]
    return normalised
