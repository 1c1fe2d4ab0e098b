# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of phase groups whose snapshots have times of their own instead of a grid.

What :mod:`.weights` does for frames that follow each other, for packets: a group is modelled as
tones plus clutter at its exact times, and solved by least squares. Lines do not alias here, unless
packets are regular: two lines are one tone where these times do not distinguish them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre

from ..errors import InputError
from .lines import Tone, with_mirrors
from .weights import WORST_PARTIAL_GAIN, PartialWeights, ToneTable, noise_gain, parts_of_waves

# Lines whose correlation over the times exceeds the first are one tone: sinc(0.3), as on a grid
# (lines.py). A line is left out where its correlation with its own mirror image, or the share of
# it that is clutter, exceeds the others: half of it can then not be distinguished.
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
    """Weights of groups with times of their own: those of a typical one, ``typical_s`` (N,)."""

    typical_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    clutter_hz: float = 0.0

    @cached_property
    def times_s(self) -> np.ndarray:
        """Times of the typical group from its centre, in s; shape (N,)."""
        return self.typical_s

    def at(self, times_s: np.ndarray, states: np.ndarray | None = None) -> PartialWeights | None:
        """Weights at times (n,) from the centre, a constant per state; None if undetermined."""
        fit = self._fit(times_s, states)
        return None if fit is None else fit[0]

    def tone_noise(
        self, times_s: np.ndarray, channel: np.ndarray, states: np.ndarray | None = None
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
        self, times_s: np.ndarray, states: np.ndarray | None, shifts_hz: Sequence[float]
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

    def _fit(self, times_s: np.ndarray, states: np.ndarray | None) -> _Fit | None:
        """Least squares at these times; None when they do not determine the tones."""
        return self._solved(times_s, self._columns(times_s, states))

    def _columns(self, times_s: np.ndarray, states: np.ndarray | None) -> np.ndarray:
        """Cosines, sines and clutter at some times, and what differs from state to state."""
        upper = [tone.frequency_hz for tone in self.tones if tone.frequency_hz > 0]
        phases = 2 * np.pi * np.outer(times_s, upper)
        clutter = clutter_at(times_s, self.group_period_s, self.clutter_hz)
        columns = [np.cos(phases), np.sin(phases), clutter]
        if states is not None:
            # The constant of the first state is in the clutter.
            columns += [(states == state)[:, None] for state in np.unique(states)[1:]]
        return np.hstack(columns)

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
    """:func:`.design_weights` at the times (N,) of a typical group from its centre."""
    tones = timed_lines(clocks_hz, times_s, period_s, clutter_hz, harmonics)
    empty = np.zeros((len(tones), len(times_s)), complex)
    table = TimedTable(
        tones, empty, None, period_s / len(times_s), typical_s=times_s, clutter_hz=clutter_hz
    )
    found = table.at(times_s)
    if found is None:
        rule = (
            f"must be longer: its {len(times_s)} packets do not determine {len(tones)} lines of "
            f"the tags beside clutter of {clutter_hz:g} Hz"
        )
        raise InputError("group_length", rule, len(times_s))
    for tag, clock_hz in enumerate(clocks_hz):
        if not any(len(tone.owners) == 1 and tone.owners[0][0] == tag for tone in tones):
            rule = "must leave the tag a line that these packets distinguish from every other"
            raise InputError(f"clocks_hz[{tag}]", rule, clock_hz)
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
