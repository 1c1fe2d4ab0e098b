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

    Of the attributes of :class:`.Waveform` only the number of subcarriers has a meaning.
    ``interval_s`` is the mean time between two packets, ``window_s`` what a channel estimate
    averages, Ta, and ``frequency_hz`` (K,) that of each channel against the carrier; more than one
    where several antennas are combined.
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
        """Packets have no frames to fold; raises InputError, as the two that follow."""
        _refuse()

    def frame(self) -> np.ndarray:
        """Packets have no samples."""
        _refuse()

    def equalizer(self) -> np.ndarray:
        """Packets need no equalizer."""
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
    """What the receiver has to know of packets (:class:`PacketWaveform`).

    ``subcarriers`` are their number, centred on the carrier and ``spacing_hz`` apart, or their
    frequencies against it; ``channels`` per subcarrier are one, or one for each combination of
    antennas.
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
