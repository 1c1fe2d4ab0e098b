# SPDX-License-Identifier: GPL-3.0-or-later
"""Vectors of whole spectra, as the blocks of the chain exchange them, and occupied subcarriers."""

import numpy as np

from ...estimation.groups import Array


def occupied_subcarriers(items: Array, rows: int, bins: Array) -> Array:
    """The occupied subcarriers of vectors.

    Parameters
    ----------
    items : ndarray of complex, shape (G, N rows)
        A spectrum of N subcarriers per row.
    rows : int
        Tones or ends.
    bins : ndarray of int, shape (K,)
        FFT bins of the occupied subcarriers.

    Returns
    -------
    ndarray of complex, shape (G, rows, K)
        In double precision.

    Examples
    --------
    >>> occupied_subcarriers(np.arange(128.0)[None], 2, np.array([1, 63])).real.tolist()
    [[[1.0, 63.0], [65.0, 127.0]]]
    """
    return items.reshape(len(items), rows, -1)[:, :, bins].astype(complex)


def whole_spectra(values: Array, bins: Array, symbol_length: int) -> Array:
    """Vectors of occupied subcarriers, zeros in the others.

    Parameters
    ----------
    values : ndarray of complex, shape (G, rows, K)
    bins : ndarray of int, shape (K,)
        FFT bins of the occupied subcarriers.
    symbol_length : int
        All subcarriers, N.

    Returns
    -------
    ndarray of complex, shape (G, N rows)

    Examples
    --------
    >>> vectors = whole_spectra(np.ones((5, 2, 1)), np.array([3]), 64)
    >>> vectors.shape, np.flatnonzero(vectors[0]).tolist()
    ((5, 128), [3, 67])
    """
    items = np.zeros((*values.shape[:2], symbol_length), complex)
    items[:, :, bins] = values
    return items.reshape(len(values), -1)
