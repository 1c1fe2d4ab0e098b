# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets that another device measures the channel with: what the receiver has to know of them."""

from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from ..errors import InputError
from .waveform import Waveform

# Name of the waveform in plans and messages.
_NAME = "packets"


@dataclass(frozen=True)
class PacketWaveform(Waveform):
    """Packets instead of frames: channels are given, samples do not exist.

    Attributes
    ----------
    name, frame_length, sample_rate_hz, subcarriers, reference, preamble
        As those of :class:`.waveform.Waveform`; only the number of subcarriers has a meaning.
    first_averaged, repetitions, symbol_length, used_share
        Likewise.
    interval_s : float
        Mean time between two packets, in s.
    window_s : float
        Time that a channel estimate averages, Ta, in s.
    frequency_hz : ndarray, shape (K,)
        Of each channel against the carrier; more than one where several antennas are combined.
    """

    interval_s: float = 1e-3
    window_s: float = 6.4e-6
    frequency_hz: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def snapshot_period_s(self) -> float:
        """Mean time between two channel snapshots, in s."""
        return self.interval_s

    @property
    def averaging_s(self) -> float:
        """Time that a channel estimate averages, Ta, in s."""
        return self.window_s

    @property
    def bins(self) -> np.ndarray:
        """Index of each channel; shape (K,)."""
        return np.arange(len(self.frequency_hz))

    @property
    def mirrored(self) -> np.ndarray:
        """Index of the channel at the opposite frequency, for each; shape (K,)."""
        return np.arange(len(self.frequency_hz))[::-1]

    @property
    def outermost_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency against the carrier, in Hz."""
        return float(self.frequency_hz.min()), float(self.frequency_hz.max())

    @property
    def channel_noise_gain(self) -> float:
        """Noise variance in H over that of a sample: 1, since H is what is given."""
        return 1.0

    @property
    def folding(self) -> dict[str, int]:
        """Packets have no frames to fold.

        Raises
        ------
        InputError
        """
        _refuse()

    def frame(self) -> np.ndarray:
        """Packets have no samples.

        Raises
        ------
        InputError
        """
        _refuse()

    def equalizer(self) -> np.ndarray:
        """Packets need no equalizer.

        Raises
        ------
        InputError
        """
        _refuse()


def _refuse() -> NoReturn:
    rule = (
        "says that another device measures the channel: such a scene has no samples to send or to "
        "receive; read a file of channel snapshots with it"
    )
    raise InputError(_NAME, rule)


def packet_waveform(
    interval_s: float,
    window_s: float,
    subcarriers: int | np.ndarray,
    spacing_hz: float = 312.5e3,
    channels: int = 1,
) -> PacketWaveform:
    """What the receiver has to know of packets.

    Parameters
    ----------
    interval_s : float
        Mean time between two packets, in s.
    window_s : float
        Time that a channel estimate averages, in s.
    subcarriers : int or ndarray
        Number of subcarriers, centred on the carrier, or their frequencies against it in Hz.
    spacing_hz : float
        Distance of the subcarriers where only their number is given.
    channels : int
        Channels per subcarrier: one, or one for each combination of antennas.
    """
    if isinstance(subcarriers, np.ndarray):
        hertz = subcarriers.astype(float)
    else:
        hertz = (np.arange(subcarriers) - (subcarriers - 1) / 2) * spacing_hz
    hertz = np.repeat(hertz, channels)
    index = np.arange(len(hertz))
    return PacketWaveform(
        _NAME,
        1,
        1 / interval_s,
        index,
        np.ones(len(hertz), complex),
        np.zeros(0, complex),
        interval_s=interval_s,
        window_s=window_s,
        frequency_hz=hertz,
    )
