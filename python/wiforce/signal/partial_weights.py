# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of phase groups in which only some snapshots can be used, solved in little time.

Where other transmitters are near, every group lacks snapshots. The least-squares weights over the
rest are therefore solved by normal equations in real arithmetic, of which those of a complete
group, known beforehand, need only to be reduced by the rows that are absent.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

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


@dataclass(frozen=True)
class PartialWeights:
    """Exact least-squares weights over the snapshots present in an incomplete group.

    Attributes
    ----------
    mask : ndarray of bool, shape (N,)
        True where a snapshot is present.
    weights : ndarray of complex, shape (M, count of present)
        As those of :class:`~.weights.ToneTable`.
    covariance : ndarray or None
        Of the noise of the snapshots present; None where it is white.
    """

    mask: np.ndarray
    weights: np.ndarray
    covariance: np.ndarray | None = None

    @cached_property
    def whitener(self) -> np.ndarray:
        """As :attr:`~.weights.ToneTable.whitener`."""
        return whitener_of(self.weights, self.covariance)

    @property
    def missing(self) -> int:
        """Number of snapshots that are absent."""
        return int(len(self.mask) - self.mask.sum())

    def apply(self, snapshots: np.ndarray) -> np.ndarray:
        """Compute the tones of a group.

        Returns ndarray of complex, shape (M, n): as :func:`tones_of`.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (count of present, n)
        """
        return tones_of(self.weights, snapshots)


class PartialSolver:
    """Solves the weights of incomplete groups of one table.

    Parameters
    ----------
    basis : ndarray of complex, shape (N, M + clutter order)
        Tones in the order of their frequency, symmetric about 0, then clutter, which is real.
    tones : int
        M, an even number.
    """

    def __init__(self, basis: np.ndarray, tones: int) -> None:
        self._half = tones // 2
        upper = basis[:, self._half : tones]
        # Cosines, sines and clutter, all of unit norm.
        columns = np.hstack([upper.real, upper.imag, basis[:, tones:].real])
        self._scale = 1 / np.linalg.norm(columns, axis=0)
        self._basis = columns * self._scale
        self._gram = self._basis.T @ self._basis

    def solve(self, mask: np.ndarray) -> PartialWeights | None:
        """Weights over the snapshots that are present.

        Returns PartialWeights or None: None when they do not determine the tones.

        Parameters
        ----------
        mask : ndarray of bool, shape (N,)
            True where a snapshot is present.
        """
        present = self._basis[mask]
        count, columns = present.shape
        if count <= columns:
            return None
        try:
            rows = self._rows(present, self._basis[~mask]) * self._scale[: 2 * self._half, None]
        except np.linalg.LinAlgError:
            return None  # LAPACK may give up on a basis that is nearly singular
        cosines, sines = rows[: self._half], rows[self._half :]
        upper = (cosines - 1j * sines) / 2
        weights = np.vstack([upper[::-1].conj(), upper])
        noise_gain = np.sum(np.abs(upper) ** 2, axis=1) * len(mask)
        return PartialWeights(mask, weights) if noise_gain.max() <= WORST_PARTIAL_GAIN else None

    def _rows(self, present: np.ndarray, absent: np.ndarray) -> np.ndarray:
        """The rows of the pseudo-inverse that belong to cosines and sines."""
        tones = 2 * self._half
        if len(absent) < len(present):
            gram = self._gram - absent.T @ absent
        else:
            gram = present.T @ present
        try:
            factor = np.linalg.cholesky(gram)
        except np.linalg.LinAlgError:
            return pseudo_inverse(present)[:tones]
        pivot = float(np.min(factor.diagonal())) ** 2
        if pivot < _LEAST_PIVOT:
            return pseudo_inverse(present)[:tones]
        inverse = np.linalg.inv(factor)
        solver = inverse.T @ inverse
        rows: np.ndarray = solver[:tones] @ present.T
        if pivot < _REFINED_PIVOT:
            rows += (np.eye(tones, len(gram)) - rows @ present) @ solver @ present.T
        return rows


def tones_of(weights: np.ndarray, snapshots: np.ndarray) -> np.ndarray:
    """Apply weights whose rows of opposite frequency are conjugates of each other.

    Returns ndarray of complex, shape (M, n): ``weights @ snapshots``; tones of opposite frequency
    share two real products.

    Parameters
    ----------
    weights : ndarray of complex, shape (M, N)
        As those of :class:`~.weights.ToneTable`.
    snapshots : ndarray of complex, shape (N, n)
    """
    upper = weights[len(weights) // 2 :]
    samples = np.ascontiguousarray(snapshots, complex).view(float)
    products = (np.vstack([upper.real, upper.imag]) @ samples).view(complex)
    in_phase, quadrature = products[: len(upper)], 1j * products[len(upper) :]
    return np.vstack([(in_phase - quadrature)[::-1], in_phase + quadrature])


def whitener_of(weights: np.ndarray, covariance: np.ndarray | None = None) -> np.ndarray:
    """Matrix that makes the noise of tones white.

    Returns ndarray of complex, shape (M, M): the inverse Cholesky factor of W C W^H.

    Parameters
    ----------
    weights : ndarray of complex, shape (M, n)
        W, from snapshots to tones.
    covariance : ndarray, shape (n, n), optional
        C, of the noise of the snapshots; the identity when not given.
    """
    colored = weights if covariance is None else weights @ covariance
    return np.linalg.inv(np.linalg.cholesky(colored @ weights.conj().T))


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Pseudo-inverse; by the slower of LAPACK's algorithms where the usual one does not converge.

    Returns ndarray, shape (n, m).

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
        Real or complex.

    Notes
    -----
    The divide-and-conquer SVD (gesdd) of OpenBLAS 0.3.21 fails for some nearly singular bases,
    which NumPy reports as LinAlgError or, when LAPACK complains as well, as SystemError.
    """
    try:
        return np.linalg.pinv(matrix, rcond=_SINGULAR)
    except (np.linalg.LinAlgError, SystemError):
        from scipy.linalg import svd  # hardly ever needed, and slow to import

        left, sizes, right = svd(matrix, full_matrices=False, lapack_driver="gesvd")
        kept = sizes > _SINGULAR * sizes[0]
        inverse: np.ndarray = (right[kept].conj().T / sizes[kept]) @ left[:, kept].conj().T
        return inverse
