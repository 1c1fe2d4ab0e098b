# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of the ends where a symbol is so long that tags switch within it.

Each tag's lines then spread over the subcarriers (intercarrier interference). The spread part is
not noise: it is the same from group to group, and adds nothing to the error of a phase. But it is
in the residual, and would be taken for noise there.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ..signal.waveform import Waveform
from .group_tones import power_of
from .groups import Array
from .least_squares import GroupFit

# Median of an exponential distribution over its mean.
_MEDIAN = np.log(2.0)
# Groups of the median over changes, as in ``coherence``, and its standard deviations above which
# it is more than noise. Median of the square of a normal variable, and the standard deviation of
# the median of n such squares relative to it, times sqrt(n).
_GROUPS, _STDS = 48, 4.0
_SQUARE_MEDIAN, _SQUARE_SPREAD = 0.455, 2.33
# Error of a phase, in rad, that noise does not explain: 0.014 deg (1024 samples, SNR 20 dB, symbol
# of 0.05 of the tag's period; tests/waveform_captures.py). Spread lines of group and reference
# correlate a little.
_LEAST_ERROR = 2.4e-4


class LongSymbolNoise:
    """Variance of the ends' noise relative to what the residual suggests.

    Parameters
    ----------
    waveform : Waveform
        With a symbol that ``resolves_spread_lines``.
    ends : int
        Ends of all tags, 2S.

    Notes
    -----
    Over the subcarriers, noise is white. The spread lines have the few delays of the tag's channel
    where the symbol is a chirp, and few others where it is a Zadoff-Chu sequence: a shift in
    frequency is a delay for both. The median of the residual's power over all delays is therefore
    that of the noise. Of a symbol without such an order, the spread lines fill all delays and
    remain noise.

    Interference that is coherent over the subcarriers has few delays too, so it is seen otherwise:
    it changes an end from group to group by more than noise does.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> chirp = sounding_waveform("chirp", 512, repetitions=3, averaged_repetitions=2)
    >>> rng, tones = np.random.default_rng(1), np.eye(16)[:, :2].astype(complex)
    >>> noise = rng.standard_normal((16, 126, 2)) @ [0.7071, 0.7071j]
    >>> noise[:2] = 0
    >>> spread = noise + 3 * np.exp(1j * chirp.subcarriers / 20)
    >>> white, solver, gain = tones[None], tones.T[None], np.ones((1, 2))
    >>> fit = GroupFit(
    ...     np.arange(2), np.ones((1, 2, 126)), gain, spread[None], white, solver, white)
    >>> level = fit.noise().mean()
    >>> stated, _ = LongSymbolNoise(chirp, 2).update(fit, np.full(126, 1 / level), gain)
    >>> bool(level > 8), bool(np.all(stated * level < 1.5))  # of noise alone it is 1
    (True, True)
    """

    def __init__(self, waveform: Waveform, ends: int) -> None:
        self._bins = waveform.bins
        self._length = waveform.symbol_length
        across = waveform.subcarriers - waveform.subcarriers[0] + 1.0
        self._window = np.sin(np.pi * across / (across[-1] + 1)) ** 2
        self._ends = ends
        self.reset()

    def reset(self) -> None:
        """Forget the groups so far, when the clocks were acquired again."""
        # Of each end in the last group: its channel and the variance of its noise.
        self._last: list[tuple[Array, float] | None] = [None] * self._ends
        self._changes: list[deque[float]] = [deque(maxlen=_GROUPS) for _ in range(self._ends)]

    def update(self, fit: GroupFit, inverse_noise: Array, raised: Array) -> tuple[Array, Array]:
        """Take the fit of some groups.

        Parameters
        ----------
        fit : GroupFit
        inverse_noise : ndarray, shape (G, K) or (K,)
            1 / sigma_k^2, with what is spread over the subcarriers.
        raised : ndarray, shape (G, 1) or (G, E)
            Factor of the noise in groups that a burst hit.

        Returns
        -------
        gain : ndarray, shape (G, E)
            Variance of V over ``sigma_k^2``.
        unsteady : ndarray of bool, shape (G, E)
            Whether an end changes from group to group by more than noise.
        """
        weights = np.broadcast_to(inverse_noise, (len(fit.ends), fit.ends.shape[2]))
        share = np.array([self._share(*each) for each in zip(fit.residual, weights, strict=True)])
        share = np.minimum(share * fit.residual.shape[1] / fit.freedom, 1.0)
        energy = np.sum(power_of(fit.ends) * weights[:, None], axis=2)
        factors = np.ones(fit.gain.shape)
        for g, own in enumerate(weights):
            for e, row in enumerate(fit.rows.tolist()):
                variance = float(share[g] * fit.gain[g, e] / max(energy[g, e], 1e-300))
                factors[g, e] = self._factor(row, fit.ends[g, e] * own, fit.ends[g, e], variance)
        gain = share[:, None] * fit.gain * np.maximum(factors, raised)
        return gain + 2 * _LEAST_ERROR**2 * energy, factors > 1

    def _share(self, residual: Array, weights: Array) -> float:
        """Mean over the tones of the median power over the delays, relative to 1 / weights."""
        spectrum = np.zeros((len(residual), self._length), complex)
        spectrum[:, self._bins] = residual * (self._window * np.sqrt(weights))
        power = power_of(np.fft.ifft(spectrum, axis=1, norm="forward"))
        median = np.median(power, axis=1).mean() / _MEDIAN
        return float(median / np.sum(self._window**2))

    def _factor(self, row: int, weighted: Array, end: Array, variance: float) -> float:
        """Median over the last groups of an end's changes in phase, over those of noise."""
        last, self._last[row] = self._last[row], (end, variance)
        changes = self._changes[row]
        if last is not None:
            energy = max(float(np.vdot(weighted, end).real), 1e-300)
            change = float(np.vdot(weighted, end - last[0]).imag) / energy
            # Half of a complex variance lies along the phase.
            changes.append(2 * change**2 / max(variance + last[1], 1e-300))
        if not changes:
            return 1.0
        found = float(np.median(list(changes))) / _SQUARE_MEDIAN
        return found if found > 1 + _STDS * _SQUARE_SPREAD / np.sqrt(len(changes)) else 1.0
