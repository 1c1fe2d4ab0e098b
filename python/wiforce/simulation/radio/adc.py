# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver's analogue-to-digital converter."""

import numpy as np
from numpy.typing import ArrayLike


class Adc:
    """An analogue-to-digital converter: rounds, clips, and left-justifies its codes in 16 bits.

    Parameters
    ----------
    bits : int or None
        Resolution; None means 16 bits.
    """

    def __init__(self, bits: int | None) -> None:
        self.bits = bits or 16
        self._half = 2 ** (self.bits - 1)

    def codes(self, samples: ArrayLike) -> np.ndarray:
        """Convert samples.

        Returns ndarray of int16, shape (2 n,): I and Q in turn.

        Parameters
        ----------
        samples : array_like of complex, shape (n,)
            Full scale is 1 per component.
        """
        parts = np.ascontiguousarray(samples, np.complex64).view(np.float32) * self._half
        np.rint(parts, out=parts)
        np.minimum(parts, self._half - 1, out=parts)
        np.maximum(parts, -self._half, out=parts)
        return parts.astype(np.int16) << (16 - self.bits)
