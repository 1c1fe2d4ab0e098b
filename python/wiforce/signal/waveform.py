# SPDX-License-Identifier: GPL-3.0-or-later
"""The sounding frame: what a reader transmits and how a snapshot of the channel follows from it.

This definition is all of the signal model that simulator and estimator share.
"""

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError

FFT_LENGTH = 64
PREAMBLE_LENGTH = 320

# Long training sequence of IEEE 802.11-2020, 17.3.3, subcarriers -26..26.
_WIFI_LONG = np.array(
    [1, 1, -1, -1, 1, 1, -1, 1, -1, 1, 1, 1, 1, 1, 1, -1, -1, 1, 1, -1, 1, -1, 1, 1, 1, 1]
    + [0]
    + [1, -1, -1, 1, 1, -1, 1, -1, 1, -1, -1, -1, -1, -1, 1, 1, -1, -1, 1, -1, 1, -1, 1, 1, 1, 1],
    dtype=float,
)
# Short training sequence: subcarrier -> sign of (1 + j).
_WIFI_SHORT = {-24: 1, -20: -1, -16: 1, -12: -1, -8: -1, -4: 1}
_WIFI_SHORT |= {4: -1, 8: -1, 12: 1, 16: 1, 20: 1, 24: 1}


def _symbol(subcarriers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Time samples of one OFDM symbol with unit mean power; complex128, shape (64,)."""
    spectrum = np.zeros(FFT_LENGTH, complex)
    spectrum[np.asarray(subcarriers) % FFT_LENGTH] = values
    return np.fft.ifft(spectrum) * FFT_LENGTH / np.sqrt(np.sum(np.abs(values) ** 2))


@dataclass(frozen=True)
class Waveform:
    """A sounding frame: preamble, then zeros up to ``frame_length`` samples.

    Attributes
    ----------
    name : str
        ``repeated`` or ``wifi``.
    frame_length : int
        Samples per frame, at least 320.
    sample_rate_hz : float
        In Hz.
    subcarriers : ndarray of int, shape (K,)
        Occupied subcarriers in ascending order, negative ones included.
    reference : ndarray of complex, shape (K,)
        X_k on the occupied subcarriers.
    preamble : ndarray of complex, shape (320,)
        Transmit samples.
    first_averaged, repetitions : int
        The samples ``first_averaged .. first_averaged + 64 repetitions - 1`` of a frame are
        folded into their mean of 64 samples.

    Examples
    --------
    >>> waveform = sounding_waveform("wifi")
    >>> len(waveform.subcarriers), waveform.first_averaged, waveform.repetitions
    (52, 192, 2)
    """

    name: str
    frame_length: int
    sample_rate_hz: float
    subcarriers: np.ndarray = field(repr=False)
    reference: np.ndarray = field(repr=False)
    preamble: np.ndarray = field(repr=False)
    first_averaged: int = 64
    repetitions: int = 4

    @property
    def snapshot_period_s(self) -> float:
        """Time between two channel snapshots, T, in s."""
        return self.frame_length / self.sample_rate_hz

    @property
    def averaging_s(self) -> float:
        """Time spanned by the averaged samples, Ta, in s."""
        return self.repetitions * FFT_LENGTH / self.sample_rate_hz

    @property
    def bins(self) -> np.ndarray:
        """FFT bin of each occupied subcarrier; shape (K,)."""
        return self.subcarriers % FFT_LENGTH

    @property
    def outermost_hz(self) -> tuple[float, float]:
        """Lowest and highest occupied frequency against the carrier, in Hz."""
        spacing_hz = self.sample_rate_hz / FFT_LENGTH
        return float(self.subcarriers[0] * spacing_hz), float(self.subcarriers[-1] * spacing_hz)

    @property
    def channel_noise_gain(self) -> float:
        """sigma_H^2 / sigma^2: noise variance in H over that of a sample, K / (64 repetitions)."""
        return len(self.subcarriers) / (self.repetitions * FFT_LENGTH)

    def equalizer(self) -> np.ndarray:
        """Factors that turn the FFT of a folded vector into the channel.

        Returns
        -------
        ndarray of complex, shape (64,)
            0 on unoccupied subcarriers.

        Notes
        -----
        H[k] = FFT64(folded)[k] / (X_k 64 / sqrt(K)).
        """
        factors = np.zeros(FFT_LENGTH, complex)
        power = np.sum(np.abs(self.reference) ** 2)
        factors[self.bins] = np.sqrt(power) / (FFT_LENGTH * self.reference)
        return factors

    @property
    def folding(self) -> dict[str, int]:
        """Arguments by name of the blocks and kernels that fold frames."""
        return {
            "frame_length": self.frame_length,
            "first_averaged": self.first_averaged,
            "repetitions": self.repetitions,
        }

    def frame(self) -> np.ndarray:
        """Transmit samples of one frame.

        Returns
        -------
        ndarray of complex, shape (frame_length,)
            Unit mean power over the preamble.
        """
        samples = np.zeros(self.frame_length, complex)
        samples[:PREAMBLE_LENGTH] = self.preamble
        return samples


def sounding_waveform(
    name: str = "repeated", frame_length: int = 720, sample_rate_hz: float = 12.5e6
) -> Waveform:
    """The waveform of a scene's ``sounding`` section.

    Parameters
    ----------
    name : str
        ``repeated``: five repetitions of one symbol on k = -31..31 without 0,
        X_k = exp(j pi k^2 / 64). ``wifi``: the 802.11 legacy preamble (160 short, 32 guard,
        2 x 64 long training samples) on 52 subcarriers.
    frame_length : int
        Samples per frame, 320 or more.
    sample_rate_hz : float
        In Hz.

    Returns
    -------
    Waveform

    Raises
    ------
    InputError
        For an unknown name, a frame shorter than its preamble, or a rate that is not positive.

    Examples
    --------
    >>> waveform = sounding_waveform()
    >>> round(waveform.snapshot_period_s * 1e6, 3), round(waveform.averaging_s * 1e6, 3)
    (57.6, 20.48)
    >>> received = 0.5j * waveform.frame()
    >>> folded = received[64:320].reshape(4, 64).mean(axis=0)
    >>> channel = np.fft.fft(folded) * waveform.equalizer()
    >>> bool(np.allclose(channel[waveform.bins], 0.5j))
    True
    """
    if int(frame_length) != frame_length or frame_length < PREAMBLE_LENGTH:
        raise InputError("frame_length", f"must be an integer >= {PREAMBLE_LENGTH}", frame_length)
    if not (np.isfinite(sample_rate_hz) and sample_rate_hz > 0):
        raise InputError("sample_rate_hz", "must be positive", sample_rate_hz)
    common = name, int(frame_length), float(sample_rate_hz)
    if name == "repeated":
        k = np.r_[-31:0, 1:32]
        x = np.exp(1j * np.pi * k**2 / FFT_LENGTH)
        return Waveform(*common, k, x, np.tile(_symbol(k, x), 5), 64, 4)
    if name == "wifi":
        k = np.r_[-26:0, 1:27]
        x = _WIFI_LONG[_WIFI_LONG != 0].astype(complex)
        short_k = np.array(list(_WIFI_SHORT))
        short = _symbol(short_k, (1 + 1j) * np.array(list(_WIFI_SHORT.values())))
        long = _symbol(k, x)
        preamble = np.concatenate([np.tile(short, 3)[:160], long[-32:], long, long])
        return Waveform(*common, k, x, preamble, 192, 2)
    raise InputError("waveform", "must be 'repeated' or 'wifi'", name)
