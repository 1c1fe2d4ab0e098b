# SPDX-License-Identifier: GPL-3.0-or-later
"""What files of CSI tools have in common: how they begin, and the subcarriers that are sent."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

_PCAP = {b"\xd4\xc3\xb2\xa1": "<", b"\xa1\xb2\xc3\xd4": ">", b"\x4d\x3c\xb2\xa1": "<"}
_NEXMON_PORT = 5500
# Of a pcap record, and of Ethernet, IP and UDP in it; then of nexmon_csi before the values.
_RECORD, _PACKET, _NEXMON = 16, 42, 18
# Chips by the number that nexmon_csi reports; those with four bytes per subcarrier as two integers.
_CHIPS = {0x65: "43455c0", 0x4339: "4339", 0x4358: "4358", 0x4366: "4366c0"}
# Subcarriers that are sent, the smallest and the largest one, by the size of the FFT (IEEE
# 802.11-2020, sections 19.3.7 and 21.3.7: 20 and 40 MHz of HT, 80 MHz of VHT). What a card reports
# of the others is noise.
_SENT = {64: (1, 28), 128: (2, 58), 256: (2, 122)}
# Codes of a record that Intel's tool writes, and the most that Atheros' tool writes in one.
_INTEL_CODES, _LONGEST = (0xBB, 0xC1), 10_000


def tool_of(path: str | Path) -> str | None:
    """The CSI tool that has written a file.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    str or None
        As for :func:`.csi_tools.open_csi`; None for files of other kinds.

    Examples
    --------
    >>> _ = Path("a.csv").write_text("type,role,mac\\nCSI_DATA,AP,00:00:00:00:00:00\\n")
    >>> tool_of("a.csv")
    'esp32'
    """
    if not Path(path).is_file():
        return None
    with Path(path).open("rb") as file:
        start = file.read(4096)
    if start.startswith((b"type,", b"CSI_DATA,")) or b"\nCSI_DATA," in start:
        return "esp32"
    if start[:4] in _PCAP:
        return _nexmon(start)
    if len(start) > 2 and start[2] in _INTEL_CODES and 1 < struct.unpack(">H", start[:2])[0]:
        length = struct.unpack(">H", start[:2])[0]
        if len(start) < length + 5 or start[length + 4] in _INTEL_CODES:
            return "intel"
    if len(start) > 27:
        length = struct.unpack("<H", start[:2])[0]
        tones = start[18]
        if 25 <= length < _LONGEST and tones in (56, 114):
            return "atheros"
    return None


def sent_subcarriers(size: int) -> np.ndarray:
    """Subcarriers that packets are sent on.

    Parameters
    ----------
    size : int
        Of the FFT: 64, 128 or 256.

    Returns
    -------
    ndarray of int, shape (K,)
        Multiples of 312.5 kHz; an array in the order of an FFT is indexed by them.

    Examples
    --------
    >>> len(sent_subcarriers(64)), sent_subcarriers(256)[-1]
    (56, 122)
    """
    lowest, highest = _SENT[size]
    return np.r_[-highest : 1 - lowest, lowest : highest + 1]


def _nexmon(start: bytes) -> str | None:
    """Chip and bandwidth of the first packet of a pcap file, where it is one of nexmon_csi."""
    order = _PCAP[start[:4]]
    if len(start) < 24 + _RECORD + _PACKET + _NEXMON:
        return None
    (length,) = struct.unpack(order + "I", start[24 + 8 : 24 + 12])
    payload = start[24 + _RECORD + _PACKET :]
    values = (length - _PACKET - _NEXMON) // 4
    chip = _CHIPS.get(struct.unpack("<H", payload[16:18])[0])
    if chip is None or values not in (64, 128, 256):
        return None
    return f"nexmon/{chip}/{values * 20 // 64}"
