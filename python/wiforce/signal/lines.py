# SPDX-License-Identifier: GPL-3.0-or-later
"""Spectral lines of tags, and the clutter and noise of a room between them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

_Hz = TypeVar("_Hz", float, np.ndarray)

# Two lines closer than this part of the group's resolution are one tone. They overlap by
# sinc(0.3) = 0.86, so that weights which separated them would raise their noise by 5.8 dB.
_SAME_TONE = 0.3
# Lines nearer than this part of the resolution to the clutter band, or to half the snapshot rate,
# where a line meets its own mirror image, are not used.
CLUTTER_MARGIN = 0.75
# The strongest lines of a tag (docs/theory.md).
STRONG_LINES = (1, 2, 4)
# Harmonic of the clock that end 2 has to itself, and the highest one that is needed.
HIGHEST_LINE = STRONG_LINES[-1]
# Part of half the snapshot rate up to which a tag has this line; beyond it, the line comes close to
# its mirror image.
NYQUIST_MARGIN = 0.9
# A line of the room coincides with one of a tag when it lies within this part of the group's
# resolution: two sinusoids this close overlap by sinc(0.5) = 0.64.
COINCIDING_BINS = 0.5


class Tone(NamedTuple):
    """A frequency of the group's spectrum on which lines of the tags fall."""

    frequency_hz: float  # where the snapshots show it, within half the snapshot rate
    # Tag index and harmonic number of every line that falls on it.
    owners: tuple[tuple[int, int], ...]
    line_hz: float  # on the air, before aliasing, of its slowest line


def aliased_hz(frequency_hz: _Hz, sample_rate_hz: float) -> _Hz:
    """Where sampling shows a frequency on the air: in [-sample_rate_hz / 2, sample_rate_hz / 2)."""
    return (frequency_hz + sample_rate_hz / 2) % sample_rate_hz - sample_rate_hz / 2


def centered_times_s(group_length: int, snapshot_period_s: float) -> np.ndarray:
    """Times (N,) of a group's snapshots from the group's centre: (n - (N - 1) / 2) T."""
    return (np.arange(group_length) - (group_length - 1) / 2) * snapshot_period_s


def tag_lines(
    clocks_hz: Sequence[float],
    snapshot_period_s: float,
    group_length: int,
    harmonics: int = 8,
    clutter_hz: float = 0.0,
) -> tuple[Tone, ...]:
    """Tones of lines +-1..+-``harmonics`` of the tags, ascending, without those in the clutter."""
    rate = 1 / snapshot_period_s
    resolution = rate / group_length
    lines = []
    for tag, clock_hz in enumerate(clocks_hz):
        for m in range(1, harmonics + 1):
            frequency = aliased_hz(m * clock_hz, rate)
            sign = 1 if frequency >= 0 else -1
            near_nyquist = rate / 2 - abs(frequency) < CLUTTER_MARGIN * resolution
            if abs(frequency) > clutter_hz + CLUTTER_MARGIN * resolution and not near_nyquist:
                lines.append((abs(frequency), (tag, sign * m), sign * m * clock_hz))
    positive: list[Tone] = []
    for frequency, owner, line_hz in sorted(lines):
        if positive and frequency - positive[-1].frequency_hz < _SAME_TONE * resolution:
            tone = positive[-1]
            # The slower line is the stronger one, and gives the frequency on air.
            slower_hz = min(tone.line_hz, line_hz, key=abs)
            positive[-1] = Tone(tone.frequency_hz, (*tone.owners, owner), slower_hz)
        else:
            positive.append(Tone(frequency, (owner,), line_hz))
    return with_mirrors(positive)


def with_mirrors(positive: Sequence[Tone]) -> tuple[Tone, ...]:
    """Tones of positive frequency, ascending, and those at the opposite frequencies before them."""
    negative = [
        Tone(-tone.frequency_hz, tuple((tag, -m) for tag, m in tone.owners), -tone.line_hz)
        for tone in positive
    ]
    return (*negative[::-1], *positive)


def lamp_distances_hz(clocks_hz: ArrayLike, mains_hz: Sequence[float]) -> np.ndarray:
    """Distances (..., 3) of lines 1, 2 and 4 of clocks (...) to a lamp's; inf without mains."""
    lines = np.multiply.outer(clocks_hz, STRONG_LINES)
    found = np.full(lines.shape, np.inf)
    for mains in mains_hz:
        beyond = np.mod(lines, 2 * mains)
        found = np.minimum(found, np.minimum(beyond, 2 * mains - beyond))
    return found


# Sequences beyond 2NW. With ten of them the part of in-band clutter that is not in the basis
# stays below -160 dB, under the rounding of single precision.
_EXTRA_SEQUENCES = 10


def clutter_order(group_length: int, snapshot_period_s: float, clutter_hz: float) -> int:
    """Sequences of :func:`clutter_basis`: min(ceil(2 B N T) + 10, N), 1 when nothing moves."""
    if clutter_hz == 0:
        return 1
    half_bandwidth = clutter_hz * group_length * snapshot_period_s
    return min(int(np.ceil(2 * half_bandwidth)) + _EXTRA_SEQUENCES, group_length)


def _slepian_sequences(length: int, half_bandwidth: float, order: int) -> np.ndarray:
    """Discrete prolate spheroidal sequences (length, order), orthonormal, of any sign.

    Eigenvectors of a tridiagonal matrix (D. Slepian, 1978, section 2.2, equation 14), which are
    smooth: polynomials up to twice their number and 30 represent them to rounding. SciPy has the
    same, but takes long to import.
    """
    n = np.arange(length)
    degrees = min(2 * order + 30, length)
    legendre = np.polynomial.legendre.legvander((2 * n + 1) / length - 1, degrees - 1)
    basis = np.linalg.qr(legendre)[0]
    diagonal = ((length - 1) / 2 - n) ** 2 * np.cos(2 * np.pi * half_bandwidth / length)
    beside = n[1:, None] * (length - n[1:, None]) / 2
    product = diagonal[:, None] * basis
    product[1:] += beside * basis[:-1]
    product[:-1] += beside * basis[1:]
    largest_last = np.linalg.eigh(basis.T @ product)[1]
    return basis @ largest_last[:, : -order - 1 : -1]


@lru_cache(maxsize=4)  # a plan asks for the same one up to seven times
def clutter_basis(group_length: int, snapshot_period_s: float, clutter_hz: float) -> np.ndarray:
    """Orthonormal basis (N, order) of everything slower than B = ``clutter_hz`` in a phase group.

    The constant for B = 0, otherwise discrete prolate spheroidal sequences of half-bandwidth NW = B
    N T, about 2NW of which hold all energy within the band (D. Slepian, "Prolate spheroidal wave
    functions, Fourier analysis, and uncertainty - V", Bell System Technical Journal 57 (1978)).
    """
    if clutter_hz == 0:
        basis = np.full((group_length, 1), group_length**-0.5)
    else:
        half_bandwidth = clutter_hz * group_length * snapshot_period_s
        order = clutter_order(group_length, snapshot_period_s, clutter_hz)
        # In very short groups NW would round to nothing.
        basis = _slepian_sequences(group_length, max(half_bandwidth, 0.1), order)
    basis.flags.writeable = False
    return basis


class RoomNoise:
    """Noise c[n] = delta[n] + sum_l 2 p_l cos(2 pi f_l n T) of a room, over white noise.

    ``power`` (L,) is the mean at +-f, f at least 0, per subcarrier and snapshot.
    """

    def __init__(
        self,
        frequency_hz: np.ndarray,
        power: np.ndarray,
        group_length: int,
        snapshot_period_s: float,
    ) -> None:
        lags_s = np.arange(group_length) * snapshot_period_s
        self.autocovariance = (
            2 * np.asarray(power) @ np.cos(2 * np.pi * np.outer(frequency_hz, lags_s))
        )
        self.autocovariance[0] += 1.0

    def covariance(self, mask: np.ndarray | None = None) -> np.ndarray:
        """Covariance matrix (n, n) of the snapshots of a group that are present in ``mask``."""
        snapshots = np.arange(len(self.autocovariance))
        if mask is not None:
            snapshots = snapshots[mask]
        return self.autocovariance[np.abs(snapshots[:, None] - snapshots)]
