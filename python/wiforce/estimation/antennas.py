# SPDX-License-Identifier: GPL-3.0-or-later
"""Two receive antennas on one oscillator: their ratio is free of the oscillator's phase."""

import numpy as np


def channel_ratio(first, second):
    """H_1 / H_2 per snapshot and subcarrier.

    A transmitter and a receiver on clocks of their own turn every snapshot by a phase that both
    antennas share: H_a = exp(j phi) (S_a + r T_a), S_a what stands still and r T_a the tag. In
    the ratio the phase is gone, and it is linear in r while the tag is weak beside the static
    path; what is left of higher order turns a reading by up to 2 |T|/|S|. (Ratios of antennas:
    Y. Zeng et al., FarSense, 2019.)

    One antenna does not allow that: divided by its own static path, the part of the tag in
    quadrature with it is taken for a turn of the oscillator.

    Parameters
    ----------
    first, second : ndarray of complex, shape (n, K)

    Returns
    -------
    ndarray of complex, shape (n, K)
        0 where the second antenna hears nothing.
    """
    heard = np.abs(second) > 0
    return np.divide(first, second, out=np.zeros_like(first), where=heard)
