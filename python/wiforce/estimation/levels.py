# SPDX-License-Identifier: GPL-3.0-or-later
"""How received samples fill the converter: peak, clipping, DC offset, noise floor."""

from dataclasses import dataclass

import numpy as np

from ..signal.waveform import PREAMBLE_LENGTH
from .frame import MARGIN

_ECHOES = 24  # samples after the preamble that may hold what comes late
_CLIPPED = 1 - 2**-11  # of full scale: a converter's last code, after rounding on the way


@dataclass(frozen=True)
class Levels:
    """Levels of received samples, of full scale.

    Attributes
    ----------
    peak_dbfs : float
        Largest component.
    preamble_dbfs : float
        Mean power of a preamble.
    noise_dbfs : float or None
        Mean power of what is left of the guard zeros without their mean; None without a guard.
    dc_dbfs : float
        Power of the mean of all samples that see no preamble, else of all.
    clipped : float
        Share of the samples at full scale.
    """

    peak_dbfs: float
    preamble_dbfs: float
    noise_dbfs: float | None
    dc_dbfs: float
    clipped: float


def measure_levels(samples, waveform):
    """Levels of samples that begin with a frame (``frame.find_frame_offset``).

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        Full scale 1 per component; at least one frame.
    waveform : Waveform

    Returns
    -------
    Levels
    """
    length = waveform.frame_length
    frames = samples[: len(samples) // length * length].reshape(-1, length)
    parts = np.abs(samples.real), np.abs(samples.imag)
    clipped = np.mean((parts[0] >= _CLIPPED) | (parts[1] >= _CLIPPED))
    guard = frames[:, PREAMBLE_LENGTH + MARGIN + _ECHOES : length - MARGIN]
    quiet = guard if guard.size else frames
    # What stands still in the guard (late echoes, DC) is no noise.
    noise = np.mean(np.abs(guard - guard.mean(axis=0)) ** 2) if guard.size else None
    return Levels(
        peak_dbfs=_db(max(part.max() for part in parts) ** 2),
        preamble_dbfs=_db(np.mean(np.abs(frames[:, MARGIN : MARGIN + PREAMBLE_LENGTH]) ** 2)),
        noise_dbfs=None if noise is None else _db(noise),
        dc_dbfs=_db(np.abs(quiet.mean()) ** 2),
        clipped=float(clipped),
    )


def _db(power):
    return float(10 * np.log10(max(power, 1e-30)))
