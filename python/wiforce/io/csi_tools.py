# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of common CSI tools, converted to channel snapshots."""

from __future__ import annotations

import csv
import re
import struct
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .capture.channel_snapshots import ChannelSnapshots, checked_snapshots
from .optional import check_installed

_PCAP = {b"\xd4\xc3\xb2\xa1": "<", b"\xa1\xb2\xc3\xd4": ">", b"\x4d\x3c\xb2\xa1": "<"}
_PCAPNG = b"\n\r\r\n"
_PICOSCENES = 0x20150315  # of each record
# Of a pcap record, and of Ethernet, IP and UDP in it; then of nexmon_csi before the values.
_RECORD, _PACKET, _NEXMON = 16, 42, 18
# Chips by the number that nexmon_csi reports; those with four bytes per subcarrier as two integers.
_CHIPS = {0x65: "43455c0", 0x4339: "4339", 0x4358: "4358", 0x4366: "4366c0"}
# Subcarriers that are sent, the smallest and the largest one, by the size of the FFT (IEEE
# 802.11-2020, sections 19.3.7 and 21.3.7: 20 and 40 MHz of HT, 80 MHz of VHT). What a card reports
# of the others is noise.
_SENT = {64: (1, 28), 128: (2, 58), 256: (2, 122)}
# Codes of a record that Intel's tool writes, and the most bytes of a record.
_INTEL_CODES, _LONGEST = (0xBB, 0xC1), 10_000


def tool_of(path: str | Path) -> str | None:
    """The CSI tool that has written a file, None for others; refuses those that are not read."""
    if not Path(path).is_file():
        return None
    with Path(path).open("rb") as file:
        start = file.read(_SEARCHED_BYTES)
    if start.startswith((b"type,", b"CSI_DATA,")) or b"\nCSI_DATA," in start:
        return "esp32"
    if start[:4] in _PCAP:
        return _nexmon_tool(Path(path), start)
    if start[:4] == _PCAPNG:
        raise InputError(path, "is a pcapng file; convert it to pcap (editcap -F pcap)")
    found = next((name for name, of in _RECORDS.items() if _follow_each_other(start, of)), None)
    if found == "PicoScenes":
        raise InputError(path, "is a file of PicoScenes; export its arrays to an .npz file")
    return found


def _follow_each_other(data: bytes, length_of: Callable[[bytes], int]) -> bool:
    """Whether a file begins with records, one behind the other."""
    at = 0
    for number in range(_FOLLOWING):
        head = data[at : at + _HEAD]
        if len(head) < _HEAD:
            return number == _FOLLOWING - 1
        if not 0 < (length := length_of(head)) < _LONGEST:
            return False
        at += length
    return True


def _intel_length(head: bytes) -> int:
    """Bytes of a record of the Linux 802.11n CSI Tool by its first ones; 0 where it is none."""
    length, code = struct.unpack_from(">HB", head)
    bits = 30 * (16 * head[11] * head[12] + 3)
    if code == _INTEL_CODES[0] and length != 21 + (bits + 7) // 8 or code not in _INTEL_CODES:
        return 0
    return int(length) + 2


def _atheros_length(head: bytes) -> int:
    """The same of the Atheros CSI Tool."""
    length, size = struct.unpack_from("<H", head)[0], struct.unpack_from("<H", head, 10)[0]
    tones, antennas, streams = head[18:21]
    bits = 20 * tones * antennas * streams
    is_one = tones in (56, 114) and 25 + size <= length
    return length + 2 if is_one and size in (0, (bits + 7) // 8, (bits + 15) // 16 * 2) else 0


def _picoscenes_length(head: bytes) -> int:
    """The same of PicoScenes."""
    length, magic = struct.unpack_from("<II", head)
    return length + 4 if magic == _PICOSCENES else 0


# Bytes in which files are recognised, of a record those that tell its length, and records that must
# follow each other: of random bytes, fewer than one in a billion files do so.
_SEARCHED_BYTES, _HEAD, _FOLLOWING = 1 << 16, 21, 4
_RECORDS = {
    "intel": _intel_length,
    "atheros": _atheros_length,
    "PicoScenes": _picoscenes_length,
}


def sent_subcarriers(size: int) -> np.ndarray:
    """Subcarriers that packets are sent on, for an FFT of 64, 128 or 256, by its order."""
    lowest, highest = _SENT[size]
    return np.r_[-highest : 1 - lowest, lowest : highest + 1]


def _nexmon_tool(path: Path, start: bytes) -> str:
    """Chip and bandwidth of the first packet of a pcap file; refuses those of other programs."""
    order = _PCAP[start[:4]]
    payload = start[24 + _RECORD + _PACKET :]
    chip = values = None
    if len(payload) >= _NEXMON:
        (length,) = struct.unpack(order + "I", start[24 + 8 : 24 + 12])
        values = (length - _PACKET - _NEXMON) // 4
        chip = _CHIPS.get(struct.unpack("<H", payload[16:18])[0])
    if chip is None or values not in _SENT:
        rule = "is a pcap file whose first packet is none of nexmon_csi; name CHIP and MHZ by "
        raise InputError(path, rule + "--csi-tool")
    return f"nexmon/{chip}/{values * 20 // 64}"


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
class Packets:
    """Packets of one sender."""

    time_s: np.ndarray  # (n,), by the device's clock, unwrapped
    channel: np.ndarray  # (n, K) or, of several antennas, (n, K, A); complex
    subcarriers: np.ndarray  # (K,), in multiples of 312.5 kHz
    left_out: tuple[tuple[str, int], ...]  # why some were left out, and their number
    identifier: np.ndarray | None = None  # (n,), number that the sender has given each packet


def read_esp32(path: str | Path, mac: str | None = None) -> Packets:
    """Read an ESP32's packets of the most frequent length, of ``mac`` or the most frequent one."""
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
    return Packets(_unwrapped_s(stamps), channel, subcarriers, left_out, identifier)


def _unwrapped_s(microseconds: np.ndarray) -> np.ndarray:
    """Times (n,) of a clock of 32 bits that wraps, since the first one, in s."""
    microseconds = microseconds.astype(np.int64)
    return (np.unwrap(microseconds, period=_WRAP) - microseconds[:1]) * 1e-6


def together(first: Packets, second: Packets, path: Path) -> Packets:
    """Two ESP32 on one crystal as two antennas (n, K, 2): packets that both have received."""
    if first.identifier is None or second.identifier is None:
        rule = "must number the packets (column id), so that those of two devices can be matched"
        raise InputError(path, rule)
    if not np.array_equal(first.subcarriers, second.subcarriers):
        count = len(second.subcarriers)
        raise InputError(path, "must have the subcarriers of the other file", count)
    _, one, other = np.intersect1d(first.identifier, second.identifier, return_indices=True)
    order = np.argsort(one)
    one, other = one[order], other[order]
    single = len(first.identifier) + len(second.identifier) - 2 * len(one)
    channel = np.stack([first.channel[one], second.channel[other]], axis=2)
    lost = ("packet that one device received", single)
    left_out = (*first.left_out, *second.left_out, lost)
    return Packets(first.time_s[one], channel, first.subcarriers, left_out, first.identifier[one])


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

    The last of the fields that follow each other, 64 subcarriers of the legacy one, 64 or 128 of
    the HT one (ESP-IDF programming guide), each in the order of an FFT; odd numbers rise, as from
    an ESP32-C5.
    """
    if count % 2:
        return np.arange(count), np.arange(count) - count // 2
    last = {64: 64, 128: 64, 192: 128}.get(count)
    if last is None:
        return np.arange(count), np.fft.fftfreq(count, 1 / count).round().astype(int)
    sent = sent_subcarriers(last)
    return count - last + sent % last, sent


# Linux 802.11n CSI Tool (Intel 5300); Atheros CSI Tool; ESP32-CSI-Tool, esp-csi or esp-crab;
# nexmon_csi, as nexmon/43455c0/80.
TOOLS = ("intel", "atheros", "esp32", "nexmon/CHIP/MHZ")
_SPACING_HZ = 312.5e3
# Reported subcarriers of the Intel 5300, in 20 and 40 MHz (D. Halperin et al., "Tool release:
# gathering 802.11n traces with channel state information", 2011; IEEE 802.11n-2009, table 7-25f).
_INTEL_20 = np.r_[-28:-1:2, -1, 1:28:2, 28]
_INTEL_40 = np.r_[-58:-1:4, 2:59:4]
# Bit of rate_n_flags of a packet of 40 MHz.
_INTEL_WIDE = 0x800
# Shortest record: 27 bytes, and 56 subcarriers of one antenna and stream at 20 bits each. csiread
# assumes longer ones, and has no room for the rest.
_ATHEROS_BYTES = 27 + 140
# Longest time that a conversion may take, in s and s per byte: a file of 1 GB takes about one
# minute, and csiread never ends with some damaged ones.
_START_S, _BYTE_S = 60.0, 6e-7
_CHILD = "import sys; from gnuradio.wiforce.io.csi_tools import convert; convert(*sys.argv[1:])"


def open_csi(
    path: str | Path,
    tool: str | None = None,
    mac: str | None = None,
    second: str | Path | None = None,
) -> ChannelSnapshots:
    """Read a CSI tool's file: the first spatial stream, of the antennas that are used.

    ``tool`` of :data:`TOOLS` and sender ``mac`` are found by default; ``second`` is the file of a
    second ESP32 on the same crystal, the second antenna.
    """
    path = Path(path)
    for each in (path, *([Path(second)] if second else [])):
        if not each.is_file():
            raise InputError(each, "is not a file, or does not exist")
    tool = tool_of(path) if tool is None else tool
    if tool is None:
        raise InputError(path, "is no file of a CSI tool that is known; name it by --csi-tool")
    check_tool(tool, mac, second)
    if tool == "esp32":
        return _open_esp32(path, mac, None if second is None else Path(second))
    check_installed(path, ["csiread"])
    import subprocess  # for files of these tools only
    import tempfile

    with tempfile.TemporaryDirectory(prefix=".csi-") as folder:
        output = Path(folder) / "csi.npz"
        command = [sys.executable, "-c", _CHILD, str(path.resolve()), tool, str(output), mac or ""]
        limit_s = _START_S + _BYTE_S * path.stat().st_size
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s)
        except subprocess.TimeoutExpired as error:
            raise InputError(path, f"takes csiread longer than {limit_s:.0f} s") from error
        if done.returncode or not output.exists():
            said = done.stderr.strip().splitlines()
            reason = said[-1] if said and done.returncode > 0 else "its parser crashed"
            raise InputError(path, f"cannot be read by csiread as a file of {tool} ({reason})")
        with np.load(output, allow_pickle=False) as arrays:
            counts = zip(arrays["reasons"].tolist(), arrays["counts"].tolist(), strict=True)
            time_s, channel, hertz = (arrays[n] for n in ("time_s", "channel", "subcarrier_hz"))
            return checked_snapshots(path, time_s, channel, hertz, left_out=tuple(counts))


def _open_esp32(path: Path, mac: str | None, second: Path | None) -> ChannelSnapshots:
    packets = read_esp32(path, mac)
    if second is not None:
        packets = together(packets, read_esp32(second, mac), second)
    hertz, lost = packets.subcarriers * _SPACING_HZ, packets.left_out
    return checked_snapshots(path, packets.time_s, packets.channel, hertz, left_out=lost)


def check_tool(tool: str, mac: str | None = None, second: str | Path | None = None) -> None:
    """Refuse an unknown tool, and what does not go with it, as :func:`open_csi`."""
    chips = "|".join(_CHIPS.values())
    if not re.fullmatch(rf"intel|atheros|esp32|nexmon/({chips})/(20|40|80)", tool):
        raise InputError("--csi-tool", f"must be one of {', '.join(TOOLS)}", tool)
    if mac is not None:
        if tool in ("intel", "atheros"):
            rule = f"must not be given for {tool}, which records no senders"
            raise InputError("--mac", rule, mac)
        if not re.fullmatch(r"[0-9a-fA-F]{2}(:[0-9a-fA-F]{2}){5}", mac):
            raise InputError("--mac", "must be like 11:22:33:44:55:66", mac)
    if second is not None and tool != "esp32":
        raise InputError("--second-antenna", "must not be given for other tools than esp32", tool)


def convert(path: str, tool: str, output: str, mac: str = "") -> None:
    """Convert a file to the arrays of an .npz file ``output``, in a process of its own."""
    if tool.startswith("nexmon/"):
        _, chip, mhz = tool.split("/")
        found = _nexmon_packets(path, chip, mhz, mac)
    else:
        found = {"intel": _intel, "atheros": _atheros}[tool](path)
    np.savez(
        output,
        time_s=found.time_s,
        channel=found.channel,
        subcarrier_hz=found.subcarriers * _SPACING_HZ,
        reasons=np.array([reason for reason, _ in found.left_out], str),
        counts=np.array([count for _, count in found.left_out], int),
    )


_OTHER = "packet with another number of antennas, streams or subcarriers"


def _intel(path: str) -> Packets:
    from csiread import Intel

    # Four antennas instead of three: a broken permutation then stays inside the array.
    found = Intel(path, nrxnum=4, ntxnum=4, if_report=False)
    found.read()
    wide = (found.rate & _INTEL_WIDE > 0).astype(int)
    kept = _most_frequent(np.stack([found.Nrx, found.Ntx, wide], axis=1))
    subcarriers = _INTEL_40 if wide[kept].any() else _INTEL_20
    time_s = _unwrapped_s(found.timestamp_low)
    lost = ((_OTHER, int(np.count_nonzero(~kept))),)
    return Packets(time_s[kept], _used(found.csi[kept][..., 0]), subcarriers, lost)


def _atheros(path: str) -> Packets:
    from csiread import Atheros

    most = Path(path).stat().st_size // _ATHEROS_BYTES + 1
    found = Atheros(path, nrxnum=3, ntxnum=3, tones=114, if_report=False, bufsize=most)
    found.read()
    filled = found.csi_len > 0
    kept = filled.copy()
    settings = np.stack([found.num_tones, found.nr, found.nc], axis=1)
    kept[filled] = _most_frequent(settings[filled])
    tones = int(np.max(found.num_tones[kept], initial=56))
    subcarriers = sent_subcarriers(64 if tones == 56 else 128)
    channel = _used(found.csi[kept][:, : len(subcarriers), :, 0])
    time_s = (found.timestamp[kept] - found.timestamp[:1]).astype(float) * 1e-6
    lost = (
        ("packet without CSI", int(np.count_nonzero(~filled))),
        (_OTHER, int(np.count_nonzero(filled & ~kept))),
    )
    return Packets(time_s, channel, subcarriers, lost)


def _nexmon_packets(path: str, chip: str, mhz: str, mac: str) -> Packets:
    from csiread import Nexmon

    found = Nexmon(path, chip=chip, bw=int(mhz), if_report=False)
    found.read()
    time_s = (found.sec - found.sec[:1]) + found.usec * (1e-9 if found.nano else 1e-6)
    senders = np.array([":".join(f"{part:02x}" for part in each) for each in found.src_addr])
    wanted = senders == mac.lower() if mac else _most_frequent(found.src_addr)
    # A packet is reported once per core, which is an antenna, and spatial stream.
    own = np.flatnonzero(wanted & (found.spatial == 0))
    core, stamps = found.core[own], time_s[own]
    cores = np.unique(core)
    rows, place = _grouped(core, found.seq[own], stamps), np.searchsorted(cores, core)
    shape = int(rows.max(initial=-1)) + 1, found.csi.shape[1], len(cores)
    channel, seen = np.zeros(shape, complex), np.zeros((shape[0], len(cores)), bool)
    channel[rows, :, place] = found.csi[own]
    seen[rows, place] = True
    whole = seen.all(axis=1)
    first = np.flatnonzero(np.diff(rows, prepend=-1))
    subcarriers = sent_subcarriers(found.csi.shape[1])
    lost = (
        ("frame of another sender", int(np.count_nonzero(~wanted))),
        ("packet that not all cores report", int(np.count_nonzero(~whole))),
    )
    return Packets(stamps[first][whole], channel[whole][:, subcarriers], subcarriers, lost)


def _grouped(core: np.ndarray, sequence: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Number of the packet of each core's frame, (n,), also where sequence numbers stay 0."""
    latest = np.diff(time_s[core == core[0]]) if len(core) else np.zeros(0)
    apart_s = 0.5 * float(np.median(latest)) if latest.size else np.inf
    rows, row, start_s = np.zeros(len(core), int), -1, -np.inf
    held: set[int] = set()
    for i, (own, at_s) in enumerate(zip(core.tolist(), time_s.tolist(), strict=True)):
        other = i > 0 and sequence[i] != sequence[i - 1]
        if row < 0 or other or own in held or at_s - start_s > apart_s:
            row, held, start_s = row + 1, set(), at_s
        held.add(own)
        rows[i] = row
    return rows


def _most_frequent(settings: np.ndarray) -> np.ndarray:
    """Rows with the values that most rows have; ndarray of bool, shape (n,)."""
    values, of, count = np.unique(settings, axis=0, return_inverse=True, return_counts=True)
    return np.ravel(of) == np.argmax(count) if len(values) else np.zeros(len(settings), bool)


def _used(channel: np.ndarray) -> np.ndarray:
    """Antennas that most packets hold."""
    power = np.mean(np.abs(channel).sum(axis=1) > 0, axis=0)
    return channel[:, :, power > 0.5]
