# SPDX-License-Identifier: GPL-3.0-or-later
"""Symbols that a sounding frame repeats: the shipped formulas, and symbols from files.

A symbol is sent several times in a row, so that the channel is estimated from one period of a
periodic signal: by its Fourier transform, divided by that of the symbol. Any symbol serves whose
energy is spread over the subcarriers.
"""

import base64
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError

# Samples of a symbol: K = 14 subcarriers are few enough for the weakest statistics of the receiver,
# and the kernels' tables of 4096 fill the second cache.
SHORTEST_SYMBOL, LONGEST_SYMBOL = 16, 4096
# A subcarrier is used when its power is at least this share of the strongest one's. The noise of
# its channel is 20 dB higher there, so that each one left out adds less than 1 % of what the
# strongest adds to a reading.
LEAST_POWER = 0.01
# A delay and a phase, of two ends, cannot be distinguished on fewer.
LEAST_SUBCARRIERS = 4
# Part of the sample rate that the sweep covers: the flat part of a USRP's half-band filters.
_SWEPT_BAND = 0.8
# Root over length of the Zadoff-Chu sequence: that of the primary synchronisation signal of LTE, 25
# of 63 (3GPP TS 36.211, 6.11.1).
_ROOT = 25 / 63


def symbol_of(subcarriers: np.ndarray, values: np.ndarray, length: int) -> np.ndarray:
    """Time samples (length,) of one OFDM symbol with unit mean power."""
    spectrum = np.zeros(length, complex)
    spectrum[subcarriers % length] = values
    return np.fft.ifft(spectrum) * length / np.sqrt(np.sum(np.abs(values) ** 2))


def repeated_symbol(length: int) -> np.ndarray:
    """The symbol of the waveform ``repeated``: X_k = exp(j pi k^2 / N) without k = 0 and N/2."""
    k = np.arange(-((length - 1) // 2), (length + 1) // 2)
    k = k[k != 0]
    return symbol_of(k, np.exp(1j * np.pi * k**2 / length), length)


def swept_symbol(length: int, part: float) -> np.ndarray:
    """Sweep x[n] = exp(j pi B (n^2 / N - n)) over a ``part`` B of the sample rate.

    B = 1, N = 2^SF is LoRa's up-chirp (L. Vangelista, IEEE Signal Processing Letters 24(12), 2017,
    eq. (2)), the sawtooth that of A. G. Stove, Linear FMCW radar techniques, IEE Proceedings F
    139(5), 1992.
    """
    n = np.arange(length)
    return np.exp(1j * np.pi * part * (n**2 / length - n))


def zadoff_chu(length: int) -> np.ndarray:
    """Zadoff-Chu sequence x[n] = exp(-j pi u n (n + N mod 2) / N), u coprime to N from 25/63 N on.

    D. C. Chu, Polyphase codes with good periodic correlation properties, IEEE Transactions on
    Information Theory 18(4), 1972.
    """
    root = round(_ROOT * length)
    while math.gcd(root, length) > 1:
        root += 1
    n = np.arange(length)
    return np.exp(-1j * np.pi * root * n * (n + length % 2) / length)


# Name in a scene: formula, and default length.
SYMBOLS: dict[str, tuple[Callable[[int], np.ndarray], int]] = {
    "repeated": (repeated_symbol, 64),
    "chirp": (partial(swept_symbol, part=1.0), 128),
    "fmcw": (partial(swept_symbol, part=_SWEPT_BAND), 128),
    "zadoff-chu": (zadoff_chu, 63),
}


def used_subcarriers(symbol: np.ndarray) -> np.ndarray:
    """Subcarriers (K,), rising, with energy; not 0 (offset, leakage) nor -N/2 (aliased edges)."""
    length = len(symbol)
    power = np.abs(np.fft.fft(symbol)) ** 2
    k = np.arange(-((length - 1) // 2), (length + 1) // 2)
    return k[(k != 0) & (power[k % length] >= LEAST_POWER * power.max())]


def checked_symbol(values: np.ndarray, where: object) -> np.ndarray:
    """A symbol in single precision, its largest component 1; refused unless it can be used."""
    if values.dtype.kind != "c":
        raise InputError(where, "must hold complex samples", str(values.dtype))
    if values.ndim != 1 or not SHORTEST_SYMBOL <= len(values) <= LONGEST_SYMBOL:
        rule = f"must hold one symbol of {SHORTEST_SYMBOL} to {LONGEST_SYMBOL} samples"
        raise InputError(where, rule, f"shape {values.shape}")
    finite = np.isfinite(values)
    if not finite.all():
        first = int(np.argmin(finite))
        raise InputError(where, f"must hold finite samples, sample {first} is not", values[first])
    symbol = values.astype(complex)
    peak = max(np.abs(symbol.real).max(), np.abs(symbol.imag).max())
    if not peak > 0:
        raise InputError(where, "must not be zero at all samples")
    # In two steps: the reciprocal of the smallest floats is infinite.
    symbol = (symbol / peak).astype(np.complex64)
    used = used_subcarriers(symbol)
    if len(used) < LEAST_SUBCARRIERS:
        rule = (
            f"must have energy on {LEAST_SUBCARRIERS} or more subcarriers beside 0 and half the "
            f"sample rate, within {-10 * np.log10(LEAST_POWER):.0f} dB of the strongest"
        )
        raise InputError(where, rule, len(used))
    return symbol


def read_symbol(path: str | Path, where: object = None) -> np.ndarray:
    """Read the symbol of a ``.npy`` file; checked, and objects are not unpickled."""
    name = str(path) if where is None else f"{where}: {path}"
    if not Path(path).is_file():
        raise InputError(name, "is no file" if Path(path).exists() else "does not exist")
    try:
        # Of a mapped file the shape is known before anything is read, and objects are refused.
        values = np.lib.format.open_memmap(str(path), mode="r")
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror or error})") from None
    except Exception:
        # A damaged header raises errors of any kind from the parser.
        raise InputError(name, "must be a .npy file of complex samples") from None
    return checked_symbol(values, name)


def encode_symbol(symbol: np.ndarray) -> str:
    """A symbol as text, as captures store it: little-endian complex64 in base64 (RFC 4648)."""
    return base64.b64encode(symbol.astype("<c8").tobytes()).decode("ascii")


def decode_symbol(text: str, where: object = "symbol") -> np.ndarray:
    """The inverse of :func:`encode_symbol`, checked by :func:`checked_symbol`."""
    rule = "must be samples of complex64 in base64"
    try:
        content = base64.b64decode(text, validate=True)
    except ValueError:
        raise InputError(where, rule) from None
    if len(content) % 8:
        raise InputError(where, rule, f"{len(content)} bytes")
    return checked_symbol(np.frombuffer(content, "<c8"), where)
