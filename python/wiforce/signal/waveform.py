# SPDX-License-Identifier: GPL-3.0-or-later
"""Sounding frames and packets: what is sent, and when a snapshot of it counts."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NoReturn

import numpy as np

from ..errors import InputError
from .symbols import (
    LONGEST_SYMBOL,
    SHORTEST_SYMBOL,
    SYMBOLS,
    read_symbol,
    symbol_of,
    used_subcarriers,
)

# Names of the waveforms; anything else is a file.
WAVEFORMS = ("repeated", "wifi", *(name for name in SYMBOLS if name != "repeated"))
# What is sent of a symbol unless stated otherwise. The first repetition takes up echoes.
_REPETITIONS = 5
# Share of a frame up to which a symbol is short: that of the default preamble without a guard.
# Symbols of a quarter left errors of 3 to 10 dB above the bound when they were derotated.
_DEROTATED_SHARE = 0.2
# Samples of a symbol of the 802.11 preamble, and of the whole.
_WIFI_SYMBOL, _WIFI_PREAMBLE = 64, 320

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


@dataclass(frozen=True)
class Waveform:
    """A sounding frame: preamble, then zeros up to ``frame_length`` samples.

    Attributes
    ----------
    name : str
        One of :data:`WAVEFORMS`, or the file of the symbol.
    frame_length : int
        Samples per frame, at least those of the preamble.
    sample_rate_hz : float
        In Hz.
    subcarriers : ndarray of int, shape (K,)
        Occupied subcarriers in ascending order, negative ones included.
    reference : ndarray of complex, shape (K,)
        X_k on the occupied subcarriers.
    preamble : ndarray of complex, shape (preamble_length,)
        Transmit samples.
    first_averaged, repetitions : int
        The samples ``first_averaged .. first_averaged + symbol_length repetitions - 1`` of a
        frame are folded into their mean of ``symbol_length`` samples.
    symbol_length : int
        Samples of the symbol, and points of its Fourier transform, N.
    used_share : float
        Share of the symbol's energy that lies on ``subcarriers``.
    """

    name: str
    frame_length: int
    sample_rate_hz: float
    subcarriers: np.ndarray = field(repr=False)
    reference: np.ndarray = field(repr=False)
    preamble: np.ndarray = field(repr=False)
    first_averaged: int = 64
    repetitions: int = 4
    symbol_length: int = 64
    used_share: float = 1.0

    @property
    def preamble_length(self) -> int:
        """Samples of the preamble."""
        return len(self.preamble)

    @property
    def symbol(self) -> np.ndarray:
        """The symbol whose repetitions are averaged; complex, shape (symbol_length,)."""
        return self.preamble[self.first_averaged :][: self.symbol_length]

    @property
    def prefix_length(self) -> int:
        """Samples before the averaged ones that are those a symbol later, as a cyclic prefix."""
        sent, first = self.preamble, self.first_averaged
        differs = np.flatnonzero(~np.isclose(sent[:first], sent[self.symbol_length :][:first]))
        return first - 1 - int(differs[-1]) if len(differs) else first

    @property
    def is_derotated(self) -> bool:
        """Whether the rotation of a tone within the symbol is undone before the FFT.

        It concentrates each line, but not what is aliased to it: only while symbols are short in
        frames.
        """
        return self.symbol_length <= _DEROTATED_SHARE * self.frame_length

    @property
    def noise_profile(self) -> np.ndarray:
        """Noise in H on each subcarrier, relative to their harmonic mean; shape (K,)."""
        power = np.abs(self.reference) ** 2
        profile: np.ndarray = power.mean() / power
        return profile

    @property
    def spacing_hz(self) -> float:
        """Distance of neighbouring subcarriers, in Hz."""
        return self.sample_rate_hz / self.symbol_length

    @cached_property
    def mirrored(self) -> np.ndarray:
        """Index of subcarrier -k for each k, -1 where it is not occupied; shape (K,)."""
        order = {k: index for index, k in enumerate(self.subcarriers.tolist())}
        return np.array([order.get(-k, -1) for k in self.subcarriers.tolist()])

    @property
    def snapshot_period_s(self) -> float:
        """Time between two channel snapshots, T, in s."""
        return self.frame_length / self.sample_rate_hz

    @property
    def averaging_s(self) -> float:
        """Time spanned by the averaged samples, Ta, in s."""
        return self.repetitions * self.symbol_length / self.sample_rate_hz

    @property
    def bins(self) -> np.ndarray:
        """FFT bin of each occupied subcarrier; shape (K,)."""
        return self.subcarriers % self.symbol_length

    @property
    def outermost_hz(self) -> tuple[float, float]:
        """Lowest and highest occupied frequency against the carrier, in Hz."""
        spacing_hz = self.spacing_hz
        return float(self.subcarriers[0] * spacing_hz), float(self.subcarriers[-1] * spacing_hz)

    @property
    def channel_noise_gain(self) -> float:
        """sigma_H^2 / sigma^2: noise in H over a sample's, the harmonic mean over k."""
        used_samples = self.repetitions * self.symbol_length * self.used_share
        return len(self.subcarriers) / used_samples

    def equalizer(self) -> np.ndarray:
        """Factors (symbol_length,) from the FFT of folded samples to the channel, or 0."""
        factors = np.zeros(self.symbol_length, complex)
        power = np.sum(np.abs(self.reference) ** 2) / self.used_share
        factors[self.bins] = np.sqrt(power) / (self.symbol_length * self.reference)
        return factors

    @property
    def folding(self) -> dict[str, int]:
        """Arguments by name of the blocks and kernels that fold frames."""
        return {
            "frame_length": self.frame_length,
            "first_averaged": self.first_averaged,
            "repetitions": self.repetitions,
            "symbol_length": self.symbol_length,
        }

    def frame(self) -> np.ndarray:
        """Transmit samples (frame_length,) of one frame, of unit mean power over the preamble."""
        samples = np.zeros(self.frame_length, complex)
        samples[: self.preamble_length] = self.preamble
        return samples


def sounding_waveform(
    name: str = "repeated",
    frame_length: int = 720,
    sample_rate_hz: float = 12.5e6,
    *,
    symbol_length: int | None = None,
    repetitions: int | None = None,
    averaged_repetitions: int | None = None,
    symbol: np.ndarray | None = None,
) -> Waveform:
    """The waveform of a scene's ``sounding`` section.

    Parameters
    ----------
    name : str
        ``repeated``: a symbol on k = -31..31 without 0, X_k = exp(j pi k^2 / 64). ``wifi``: the
        802.11 legacy preamble (160 short, 32 guard, 2 x 64 long training samples) on 52
        subcarriers. ``chirp``, ``fmcw`` or ``zadoff-chu``: see :mod:`.symbols`. Or a ``.npy``
        file with one symbol.
    frame_length : int
        Samples per frame, those of the preamble or more.
    sample_rate_hz : float
        In Hz.
    symbol_length : int, optional
        Samples of the symbol. Those of formulas are 64, 128, 128 and 63 unless given.
    repetitions : int, optional
        Symbols sent per frame, 5 unless given. Not for ``wifi``.
    averaged_repetitions : int, optional
        The last of them, which are averaged; all but the first unless given.
    symbol : ndarray of complex, optional
        The symbol, where ``name`` only says where it came from.

    Returns
    -------
    Waveform

    Raises
    ------
    InputError
        For an unknown name, a frame shorter than its preamble, or a rate that is not positive;
        for a symbol that cannot be used, and for repetitions that contradict each other.

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
    >>> chirp = sounding_waveform("chirp", 1200, symbol_length=256, repetitions=4)
    >>> chirp.preamble_length, chirp.repetitions, len(chirp.subcarriers)
    (1024, 3, 254)
    """
    if not (np.isfinite(sample_rate_hz) and sample_rate_hz > 0):
        raise InputError("sample_rate_hz", "must be positive", sample_rate_hz)
    if name == "wifi":
        for key, value in (
            ("repetitions", repetitions),
            ("averaged_repetitions", averaged_repetitions),
        ):
            if value is not None:
                raise InputError(key, "does not apply to the waveform 'wifi'", value)
        _check_symbol_length(symbol_length, _WIFI_SYMBOL)
        frame_length = _checked_frame_length(frame_length, _WIFI_PREAMBLE)
        return _wifi(name, frame_length, float(sample_rate_hz))
    sent, averaged = _checked_repetitions(repetitions, averaged_repetitions)
    if symbol is None and name in SYMBOLS:
        formula, default = SYMBOLS[name]
        length = default if symbol_length is None else symbol_length
        rule = f"an integer from {SHORTEST_SYMBOL} to {LONGEST_SYMBOL}"
        symbol = formula(_integer("symbol_length", length, rule, SHORTEST_SYMBOL, LONGEST_SYMBOL))
    if symbol is None:
        if not name.lower().endswith(".npy"):
            rule = " or ".join(f"'{each}'" for each in WAVEFORMS)
            raise InputError("waveform", f"must be {rule} or a .npy file", name)
        symbol = read_symbol(name)
    _check_symbol_length(symbol_length, len(symbol))
    frame_length = _checked_frame_length(frame_length, sent * len(symbol))
    first = (sent - averaged) * len(symbol)
    if first == 0 and frame_length > sent * len(symbol):
        rule = (
            f"must be below {sent}, the symbols that are sent: behind a guard the first one takes "
            f"up echoes"
        )
        raise InputError("averaged_repetitions", rule, averaged)
    return _of_symbol(name, frame_length, float(sample_rate_hz), symbol, sent, averaged)


def _wifi(name: str, frame_length: int, sample_rate_hz: float) -> Waveform:
    k = np.r_[-26:0, 1:27]
    x = _WIFI_LONG[_WIFI_LONG != 0].astype(complex)
    short_k = np.array(list(_WIFI_SHORT))
    short_x = (1 + 1j) * np.array(list(_WIFI_SHORT.values()))
    short = symbol_of(short_k, short_x, _WIFI_SYMBOL)
    long = symbol_of(k, x, _WIFI_SYMBOL)
    preamble = np.concatenate([np.tile(short, 3)[:160], long[-32:], long, long])
    return Waveform(name, frame_length, sample_rate_hz, k, x, preamble, 192, 2)


def _of_symbol(
    name: str,
    frame_length: int,
    sample_rate_hz: float,
    symbol: np.ndarray,
    sent: int,
    averaged: int,
) -> Waveform:
    """The waveform that repeats a symbol, with unit mean power."""
    length = len(symbol)
    if name == "repeated":
        # By definition and not by its transform, whose last digits would differ.
        k = used_subcarriers(symbol)
        x, share = np.exp(1j * np.pi * k**2 / length), 1.0
    else:
        symbol = symbol.astype(complex)
        symbol = symbol / np.sqrt(np.mean(np.abs(symbol) ** 2))
        k = used_subcarriers(symbol)
        spectrum = np.fft.fft(symbol)
        x = spectrum[k % length] / np.sqrt(length)
        share = float(np.sum(np.abs(x) ** 2)) / length
    first = (sent - averaged) * length
    preamble = np.tile(symbol, sent)
    return Waveform(
        name, frame_length, sample_rate_hz, k, x, preamble, first, averaged, length, share
    )


def _check_symbol_length(stated: int | None, length: int) -> None:
    if stated is not None and stated != length:
        raise InputError("symbol_length", f"must be {length}, as this symbol has", stated)


def _checked_frame_length(frame_length: int, least: int) -> int:
    rule = f"an integer >= {least}, the samples of the preamble"
    return _integer("frame_length", frame_length, rule, least)


def _integer(key: str, value: int, rule: str, least: int, most: float = np.inf) -> int:
    if int(value) != value or not least <= value <= most:
        raise InputError(key, f"must be {rule}", value)
    return int(value)


def _checked_repetitions(sent: int | None, averaged: int | None) -> tuple[int, int]:
    """Symbols sent, and the last of them that are averaged."""
    if sent is None:
        sent = _REPETITIONS if averaged is None else max(_REPETITIONS, int(averaged) + 1)
    sent = _integer("repetitions", sent, "a positive integer", 1)
    if averaged is None:
        averaged = max(sent - 1, 1)
    rule = f"an integer from 1 to repetitions ({sent})"
    return sent, _integer("averaged_repetitions", averaged, rule, 1, sent)


# Name of the waveform in plans and messages.
_NAME = "packets"


@dataclass(frozen=True)
class PacketWaveform(Waveform):
    """Packets instead of frames, of which channels are given: each is a frame of one sample.

    ``window_s`` is what an estimate averages, Ta, ``frequency_hz`` (K,) that of each channel, for
    each combination of antennas.
    """

    window_s: float = 6.4e-6
    frequency_hz: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def averaging_s(self) -> float:
        """Time that a channel estimate averages, Ta, in s."""
        return self.window_s

    @property
    def outermost_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency against the carrier, in Hz."""
        return float(self.frequency_hz.min()), float(self.frequency_hz.max())

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
    """A :class:`PacketWaveform` of centred subcarriers, or their frequencies."""
    if isinstance(subcarriers, np.ndarray):
        hertz = subcarriers.astype(float)
    else:
        hertz = (np.arange(subcarriers) - (subcarriers - 1) / 2) * spacing_hz
    hertz = np.repeat(hertz, channels)
    count = len(hertz)
    return PacketWaveform(
        _NAME,
        1,
        1 / interval_s,
        np.arange(count),
        np.ones(count, complex),
        np.zeros(0, complex),
        repetitions=1,
        symbol_length=count,
        window_s=window_s,
        frequency_hz=hertz,
    )
