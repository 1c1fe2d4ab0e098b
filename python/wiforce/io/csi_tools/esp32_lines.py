# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of CSI that an ESP32 prints: ESP32-CSI-Tool, and Espressif's esp-csi and esp-crab.

csiread 1.4 reads the first of these only, and fails at a header row and at lines of another length.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from .formats import sent_subcarriers

_START = "CSI_DATA"
# Columns of files without a header row, by their number: ESP32-CSI-Tool, esp-csi (get-started) and
# esp-crab, as the programs on the devices print them.
_SETTINGS = (
    "rssi,rate,sig_mode,mcs,bandwidth,smoothing,not_sounding,aggregation,stbc,fec_coding,sgi,"
    "noise_floor,ampdu_cnt,channel,secondary_channel,local_timestamp,ant,sig_len,rx_state"
)
_COLUMNS = {
    26: f"type,role,mac,{_SETTINGS},real_time_set,real_timestamp,len,CSI_DATA".split(","),
    25: f"type,id,mac,{_SETTINGS},len,first_word,data".split(","),
    15: "type,id,mac,rssi,rate,noise_floor,fft_gain,agc_gain,channel,local_timestamp,sig_len,"
    "rx_state,len,first_word,data".split(","),
}
_NEEDED = ("mac", "local_timestamp")
# The device's clock of 32 bits, in microseconds.
_WRAP = 1 << 32


@dataclass(frozen=True, eq=False)
class Esp32Packets:
    """Packets of one sender that an ESP32 has printed.

    Attributes
    ----------
    time_us : ndarray of int, shape (n,)
        By the device's clock, unwrapped.
    identifier : ndarray of int, shape (n,), or None
        Number that the sender has given each packet; None where lines have none.
    channel : ndarray of complex, shape (n, K)
    subcarriers : ndarray of int, shape (K,)
        In multiples of 312.5 kHz.
    sender : str
        Its MAC address.
    left_out : tuple of (str, int)
        Lines that were left out: the reason, and their number.

    Examples
    --------
    >>> time_us, channel = np.arange(3), np.ones((3, 64), complex)
    >>> Esp32Packets(time_us, None, channel, np.arange(64), "00:00:00:00:00:00", ()).left_out
    ()
    """

    time_us: np.ndarray
    identifier: np.ndarray | None
    channel: np.ndarray
    subcarriers: np.ndarray
    sender: str
    left_out: tuple[tuple[str, int], ...]


def read_esp32(path: str | Path, mac: str | None = None) -> Esp32Packets:
    """Read the lines of an ESP32.

    Parameters
    ----------
    path : str or Path
    mac : str, optional
        Address of the sender whose packets are wanted; the most frequent one by default.

    Returns
    -------
    Esp32Packets
        With the number of subcarriers that most packets have.

    Raises
    ------
    InputError
        For a file without such lines, or without packets of the sender.

    Examples
    --------
    >>> read_esp32("press.csv").sender  # doctest: +SKIP
    '11:22:33:44:55:66'
    """
    path = Path(path)
    rows, odd = _rows(path)
    if not rows:
        raise InputError(path, f"holds no lines that begin with {_START} and hold CSI")
    senders = Counter(row["mac"].lower() for row in rows)
    sender = mac.lower() if mac else senders.most_common(1)[0][0]
    own = [row for row in rows if row["mac"].lower() == sender]
    if not own:
        found = ", ".join(address for address, _ in senders.most_common(3))
        raise InputError("--mac", f"must be that of a sender in {path} ({found})", mac)
    lengths = Counter(len(row["values"]) for row in own)
    length = lengths.most_common(1)[0][0]
    kept = [row for row in own if len(row["values"]) == length]
    left_out = (
        ("line that is incomplete or of another kind", odd),
        ("packet of another sender", len(rows) - len(own)),
        ("packet with another number of subcarriers", len(own) - len(kept)),
    )
    pairs = np.array([row["values"] for row in kept], float)
    used, subcarriers = _layout(length // 2)
    # Pairs of imaginary and real part.
    channel = (pairs[:, 1::2] + 1j * pairs[:, ::2])[:, used]
    identifier = None
    if all("id" in row and re.fullmatch(r"\d+", row["id"]) for row in kept):
        identifier = np.array([int(row["id"]) for row in kept])
    stamps = np.array([int(row["local_timestamp"]) for row in kept])
    return Esp32Packets(
        unwrapped(stamps), identifier, channel, subcarriers, sender,
        tuple(each for each in left_out if each[1]),
    )  # fmt: skip


def unwrapped(microseconds: np.ndarray) -> np.ndarray:
    """Times of a clock of 32 bits that wraps, since the first one.

    Parameters
    ----------
    microseconds : ndarray of int, shape (n,)

    Returns
    -------
    ndarray of int, shape (n,)

    Examples
    --------
    >>> unwrapped(np.array([4294967290, 4, 10])).tolist()
    [0, 10, 16]
    """
    steps = np.diff(microseconds.astype(np.int64))
    later = (steps + _WRAP // 2) % _WRAP - _WRAP // 2
    return np.concatenate([[0], np.cumsum(later)])


def together(first: Esp32Packets, second: Esp32Packets, path: Path) -> Esp32Packets:
    """Two ESP32 on one crystal as two antennas: packets that both have received.

    Parameters
    ----------
    first, second : Esp32Packets
    path : Path
        Of the second one, for messages.

    Returns
    -------
    Esp32Packets
        With channels of shape (n, K, 2).

    Raises
    ------
    InputError
        Where lines do not number the packets, or subcarriers differ.

    Examples
    --------
    >>> together(master, slave, Path("slave.csv")).channel.shape  # doctest: +SKIP
    (1000, 64, 2)
    """
    if first.identifier is None or second.identifier is None:
        rule = "must number the packets (column id), so that those of two devices can be matched"
        raise InputError(path, rule)
    if not np.array_equal(first.subcarriers, second.subcarriers):
        raise InputError(
            path, "must have the subcarriers of the other file", len(second.subcarriers)
        )
    _, one, other = np.intersect1d(first.identifier, second.identifier, return_indices=True)
    order = np.argsort(one)
    one, other = one[order], other[order]
    single = len(first.identifier) + len(second.identifier) - 2 * len(one)
    channel = np.stack([first.channel[one], second.channel[other]], axis=2)
    left_out = (*first.left_out, *second.left_out, ("packet that one device received", single))
    return Esp32Packets(
        first.time_us[one], first.identifier[one], channel, first.subcarriers, first.sender,
        tuple(each for each in left_out if each[1]),
    )  # fmt: skip


def _rows(path: Path) -> tuple[list[dict[str, Any]], int]:
    """Values of each line that is whole, by the names of its columns; and how many are not."""
    rows: list[dict[str, Any]] = []
    columns: list[str] | None = None
    odd = 0
    with open(path, encoding="utf-8", errors="replace", newline="") as file:
        # Damaged files hold zeros, at which csv stops.
        for fields in csv.reader(line.replace("\0", "") for line in file):
            if fields and fields[0] == "type":
                # ESP32-C5 and C6 call the number of a packet seq, others id.
                columns = [{"seq": "id"}.get(name.strip(), name.strip()) for name in fields]
            elif fields and fields[0] == _START:
                row = _row(fields, columns or _COLUMNS.get(len(fields), []))
                odd += row is None
                rows += [row] if row else []
    return rows, odd


def _row(fields: list[str], columns: list[str]) -> dict[str, Any] | None:
    """A line by columns, with the numbers of its last one; None where it is not whole."""
    if len(fields) != len(columns):
        return None
    row: dict[str, Any] = dict(zip(columns, fields, strict=True))
    numbers = fields[-1].strip().strip("[]").replace(",", " ").split()
    if any(name not in row for name in _NEEDED) or not row["local_timestamp"].strip().isdigit():
        return None
    try:
        row["values"] = [int(number) for number in numbers]
    except ValueError:
        return None
    stated = row.get("len", "")
    # 128 bytes are 64 pairs; a line that was cut has fewer, or an odd number.
    whole = stated.isdigit() and len(row["values"]) == int(stated) and len(row["values"]) % 2 == 0
    return row if whole and len(row["values"]) >= 8 else None


def _layout(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Which values are read, and their subcarriers; both of shape (K,).

    The training fields follow each other: 64 subcarriers of the legacy one, then 64 or 128 of the
    HT one (ESP-IDF programming guide, Wi-Fi channel state information), each in the order of an
    FFT. Only the last field is read. Odd numbers are assumed to be in ascending order, as printed
    by an ESP32-C5.
    """
    if count % 2:
        return np.arange(count), np.arange(count) - count // 2
    last = {64: 64, 128: 64, 192: 128}.get(count)
    if last is None:
        return np.arange(count), np.fft.fftfreq(count, 1 / count).round().astype(int)
    sent = sent_subcarriers(last)
    return count - last + sent % last, sent
