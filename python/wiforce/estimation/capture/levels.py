# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of received samples: peak, clipping, DC offset, noise floor, and phase noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signal.waveform import Waveform
from ..groups import Array
from .frame import MARGIN, whole_frames

# Samples after the preamble that may hold echoes: 1.9 us at 12.5 Msps, 580 m of path.
_ECHOES = 24
# Frames from which phase noise is estimated, and how far it must exceed other noise.
_LEAST_FRAMES, _VISIBLE = 512, 1.5
# Share of full scale above which a sample counts as clipped: the last code of a 12-bit converter.
_CLIPPED = 1 - 2**-11


@dataclass(frozen=True)
class Levels:
    """Levels of received samples, relative to full scale.

    Attributes
    ----------
    peak_dbfs : float
        Largest real or imaginary part.
    preamble_dbfs : float
        Mean power of a preamble.
    noise_dbfs : float or None
        Mean power in the guard without its mean frame; None without a guard.
    dc_dbfs : float
        Power of the mean sample of the guard, or of all samples without a guard.
    clipped : float
        Share of the samples at full scale.
    phase_noise_dbc_hz : float or None
        Density of the phase of the static path in the snapshots, up to half their rate, relative to
        its power; None where it is hidden by other noise or the frames are few.
    """

    peak_dbfs: float
    preamble_dbfs: float
    noise_dbfs: float | None
    dc_dbfs: float
    clipped: float
    phase_noise_dbc_hz: float | None = None


def measure_levels(samples: Array, waveform: Waveform) -> Levels:
    """Measure the levels of samples that begin with a frame (``frame.find_frame_offset``).

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        Full scale 1 per component; at least one frame.
    waveform : Waveform
        As it was sent.
    """
    length, preamble = waveform.frame_length, waveform.preamble_length
    end, averaged = MARGIN + preamble, waveform.repetitions * waveform.symbol_length
    frames = whole_frames(samples, length)
    parts = np.abs(samples.real), np.abs(samples.imag)
    clipped = np.mean((parts[0] >= _CLIPPED) | (parts[1] >= _CLIPPED))
    guard = frames[:, preamble + MARGIN + _ECHOES : length - MARGIN]
    quiet = guard if guard.size else frames
    # Static samples in the guard (late echoes, DC offset) are not noise.
    noise = np.mean(np.abs(guard - guard.mean(axis=0)) ** 2) if guard.size else None
    return Levels(
        peak_dbfs=_db(max(part.max() for part in parts) ** 2),
        preamble_dbfs=_db(np.mean(np.abs(frames[:, MARGIN:end]) ** 2)),
        noise_dbfs=None if noise is None else _db(noise),
        dc_dbfs=_db(np.abs(quiet.mean()) ** 2),
        clipped=float(clipped),
        phase_noise_dbc_hz=_phase_noise_dbc_hz(frames[:, :end][:, -averaged:], waveform),
    )


def _phase_noise_dbc_hz(averaged: Array, waveform: Waveform) -> float | None:
    """Phase noise from the projections on their mean of what snapshots average.

    Noise of other kinds has the same density in the real part, which is subtracted. The medians
    over frequency leave out lines, those of tags included.
    """
    count = len(averaged)
    mean = averaged.mean(axis=0)
    energy = np.vdot(mean, mean).real
    if count < _LEAST_FRAMES or energy < count * np.finfo(np.float32).tiny:
        return None
    projected = averaged @ mean.conj() / energy
    window = np.hanning(count)
    spectra = np.abs(np.fft.rfft([window * projected.real, window * projected.imag])) ** 2
    other, phase = np.median(spectra[:, count // 16 :], axis=1)
    if phase < _VISIBLE * other:
        return None
    # The median of a chi-squared of two degrees of freedom is ln 2 of its mean.
    scale = waveform.snapshot_period_s / np.sum(window**2) / np.log(2)
    return _db((phase - other) * scale)


def _db(power: float) -> float:
    return float(10 * np.log10(max(power, 1e-30)))
