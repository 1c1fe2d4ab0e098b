# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of a simulated scene, in units of the signal model's rho."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .room.paths import mean_power

if TYPE_CHECKING:
    from ..scene import Scene

# Standard deviations of a noise component that count as its peak.
NOISE_PEAK = 4.5


class Levels:
    """Converts the levels that a scene states to amplitudes.

    Parameters
    ----------
    amplitude : float
        Root of the mean preamble power of the transmit samples.
    """

    def __init__(self, scene: "Scene", amplitude: float) -> None:
        self._waveform, self._sent = scene.waveform(), amplitude
        averaging_cycles = scene.sensors[0].clock_hz * self._waveform.averaging_s
        self._tag_line = float(0.25 * np.sinc(0.25) * np.sinc(averaging_cycles))

    def amplitude(self, level_db: float | None) -> float:
        """Amplitude that is ``level_db`` above |c1[1] G1|; 0 for None."""
        return 0.0 if level_db is None else self._tag_line * 10 ** (level_db / 20)

    def scaled(self, taps: np.ndarray, amplitude: float) -> np.ndarray:
        """Taps scaled to an rms amplitude over the occupied subcarriers."""
        return taps * (amplitude / np.sqrt(mean_power(taps, self._waveform)))

    def noise(self, snr_db: float) -> float:
        """Standard deviation of the noise in a sample, from |c1[1] G1|^2 against that in H."""
        variance_h = self._tag_line**2 / 10 ** (snr_db / 10)
        return self._sent * float(np.sqrt(variance_h / self._waveform.channel_noise_gain))

    def frame_peak(self) -> float:
        """Largest magnitude of the transmitted frame."""
        return self._sent * float(np.abs(self._waveform.frame()).max())

    def peak(self, paths: Sequence[np.ndarray], noise_std: float) -> float:
        """Largest expected magnitude while the scene's own frame is sent.

        Parameters
        ----------
        paths : sequence of ndarray
            FIR taps of all paths.
        noise_std : float
            Of a sample, of everything that is like noise.
        """
        frame = self._sent * np.tile(self._waveform.frame(), 2)
        longest = max(len(taps) for taps in paths)
        padded = [np.pad(taps, (0, longest - len(taps))) for taps in paths]
        total = np.sum([np.abs(np.convolve(frame, taps)) for taps in padded], axis=0)
        return float(total.max() + NOISE_PEAK * noise_std / np.sqrt(2))
