# SPDX-License-Identifier: GPL-3.0-or-later
"""Clutter: everything in a phase group that changes more slowly than a given Doppler frequency."""

import numpy as np

# Sequences beyond 2NW. With ten of them the part of in-band clutter that is not in the basis
# stays below -160 dB, under the rounding of single precision.
_EXTRA_SEQUENCES = 10


def clutter_order(group_length: int, snapshot_period_s: float, clutter_hz: float) -> int:
    """Number of sequences in :func:`clutter_basis`.

    Returns int: 1 when nothing moves, otherwise min(ceil(2 B N T) + 10, N).

    Parameters
    ----------
    group_length : int
        Snapshots per phase group, N.
    snapshot_period_s : float
        T, in s.
    clutter_hz : float
        Highest Doppler frequency B of anything that moves; 0 when nothing moves.
    """
    if clutter_hz == 0:
        return 1
    half_bandwidth = clutter_hz * group_length * snapshot_period_s
    return min(int(np.ceil(2 * half_bandwidth)) + _EXTRA_SEQUENCES, group_length)


def clutter_basis(group_length: int, snapshot_period_s: float, clutter_hz: float) -> np.ndarray:
    """Orthonormal basis of everything slower than ``clutter_hz`` in a phase group.

    Returns ndarray of float, shape (N, order): the constant alone when nothing moves, otherwise the
    first ``order`` discrete prolate spheroidal sequences of half-bandwidth NW = B N T.

    Parameters
    ----------
    group_length : int
        Snapshots per phase group, N.
    snapshot_period_s : float
        T, in s.
    clutter_hz : float
        Highest Doppler frequency B of anything that moves; 0 when nothing moves.

    Notes
    -----
    D. Slepian, "Prolate spheroidal wave functions, Fourier analysis, and uncertainty - V: the
    discrete case", Bell System Technical Journal 57 (1978): about 2NW sequences hold all the
    energy that signals of N samples can have within the band.
    """
    if clutter_hz == 0:
        return np.full((group_length, 1), group_length**-0.5)
    half_bandwidth = clutter_hz * group_length * snapshot_period_s
    order = clutter_order(group_length, snapshot_period_s, clutter_hz)
    # In very short groups NW would round to nothing.
    return _slepian_sequences(group_length, max(half_bandwidth, 0.1), order)


def _slepian_sequences(length: int, half_bandwidth: float, order: int) -> np.ndarray:
    """The first discrete prolate spheroidal sequences, shape (length, order), signs undefined.

    They are the eigenvectors of a tridiagonal matrix (Slepian 1978, section 2.2, equation 14).
    ``scipy.signal.windows.dpss`` gives the same, but SciPy's signal package takes 0.2 s to import.
    """
    from scipy.linalg import eigh_tridiagonal  # 0.1 s, which a still room does not need

    n = np.arange(length)
    diagonal = ((length - 1 - 2 * n) / 2) ** 2 * np.cos(2 * np.pi * half_bandwidth / length)
    beside = n[1:] * (length - n[1:]) / 2
    wanted = (length - order, length - 1)
    _, sequences = eigh_tridiagonal(diagonal, beside, select="i", select_range=wanted)
    return sequences[:, ::-1]
