# SPDX-License-Identifier: GPL-3.0-or-later
"""The converter behind the receiver."""

import numpy as np


class Adc:
    """An analogue-to-digital converter: rounds, clips, and left-justifies its codes in 16 bits.

    Parameters
    ----------
    bits : int or None
        None rounds to 16 bits.
    """

    def __init__(self, bits):
        self.bits = bits or 16
        self._half = 2 ** (self.bits - 1)

    def codes(self, samples):
        """Codes of complex samples (full scale 1 per component); int16, shape (2 n,), I Q I Q."""
        parts = np.ascontiguousarray(samples, np.complex64).view(np.float32) * self._half
        np.rint(parts, out=parts)
        np.minimum(parts, self._half - 1, out=parts)
        np.maximum(parts, -self._half, out=parts)
        return parts.astype(np.int16) << (16 - self.bits)
