# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the common CSI tools, but for ESP32 through the optional package csiread.

csiread parses them in C without checks of lengths: a damaged file may end the process that reads
it. It therefore runs in a process of its own.
"""

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..capture.channel_snapshots import ChannelSnapshots, checked_snapshots
from ..optional import check_installed
from .esp32_lines import read_esp32, together, unwrapped
from .formats import sent_subcarriers, tool_of

TOOLS = ("intel", "atheros", "esp32", "nexmon/CHIP/MHZ")
_SPACING_HZ = 312.5e3
# Reported subcarriers of the Intel 5300, in 20 and 40 MHz (D. Halperin et al., "Tool release:
# gathering 802.11n traces with channel state information", 2011; IEEE 802.11n-2009, table 7-25f).
_INTEL_20 = np.r_[-28:-1:2, -1, 1:28:2, 28]
_INTEL_40 = np.r_[-58:-1:4, 2:59:4]
# Bit of rate_n_flags of a packet of 40 MHz.
_INTEL_WIDE = 0x800
_NEXMON_CHIPS = ("4339", "43455c0", "4358", "4366c0")
# Shortest record: 27 bytes, and 56 subcarriers of one antenna and stream at 20 bits each. csiread
# assumes longer ones, and has no room for the rest.
_ATHEROS_BYTES = 27 + 140
# Longest time that a conversion may take, in s: a file of 1 GB takes about one minute.
_LONGEST_S = 600
_CHILD = "import sys; from gnuradio.wiforce.io.csi_tools import convert; convert(*sys.argv[1:])"


def open_csi(
    path: str | Path,
    tool: str | None = None,
    mac: str | None = None,
    second: str | Path | None = None,
) -> ChannelSnapshots:
    """Read a file of a CSI tool.

    Parameters
    ----------
    path : str or Path
    tool : str, optional
        ``intel`` (Linux 802.11n CSI Tool, Intel 5300), ``atheros`` (Atheros CSI Tool), ``esp32``
        (ESP32-CSI-Tool, esp-csi or esp-crab) or ``nexmon/CHIP/MHZ`` (nexmon_csi, such as
        ``nexmon/43455c0/80``); found by the first bytes of the file by default.
    mac : str, optional
        Address of the sender whose packets are wanted, for ``esp32`` and ``nexmon``; the most
        frequent one by default.
    second : str or Path, optional
        File of a second ESP32 on the same crystal, as on an esp-crab: the second antenna.

    Returns
    -------
    ChannelSnapshots
        Of the first spatial stream; antennas that a file does not use are left out.

    Raises
    ------
    InputError
        For another tool, a file that is missing or broken, and when ``csiread`` is not installed.

    Examples
    --------
    >>> open_csi("press.dat", "intel2")
    Traceback (most recent call last):
    gnuradio.wiforce.errors.InputError: --csi-tool: must be one of intel, atheros, esp32, \
nexmon/CHIP/MHZ, got 'intel2'
    """
    path = Path(path)
    if tool is not None:
        check_tool(tool, mac, second)
    for each in (path, *([Path(second)] if second else [])):
        if not each.is_file():
            raise InputError(each, "is not a file, or does not exist")
    if tool is None:
        tool = tool_of(path)
        if tool is None:
            raise InputError(path, "is no file of a CSI tool that is known; name it by --csi-tool")
        check_tool(tool, mac, second)
    if tool == "esp32":
        return _open_esp32(path, mac, None if second is None else Path(second))
    check_installed(path, ["csiread"])
    with tempfile.TemporaryDirectory(prefix=".csi-") as folder:
        output = Path(folder) / "csi.npz"
        command = [sys.executable, "-c", _CHILD, str(path.resolve()), tool, str(output), mac or ""]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S)
        except subprocess.TimeoutExpired as error:
            raise InputError(path, f"takes csiread longer than {_LONGEST_S} s") from error
        if done.returncode or not output.exists():
            said = done.stderr.strip().splitlines()
            reason = said[-1] if said and done.returncode > 0 else "its parser crashed"
            raise InputError(path, f"cannot be read by csiread as a file of {tool} ({reason})")
        with np.load(output, allow_pickle=False) as arrays:
            counts = zip(arrays["reasons"].tolist(), arrays["counts"].tolist(), strict=True)
            return checked_snapshots(
                path,
                arrays["time_s"],
                arrays["channel"],
                arrays["subcarrier_hz"],
                left_out=tuple((reason, count) for reason, count in counts if count),
            )


def _open_esp32(path: Path, mac: str | None, second: Path | None) -> ChannelSnapshots:
    packets = read_esp32(path, mac)
    if second is not None:
        packets = together(packets, read_esp32(second, mac), second)
    return checked_snapshots(
        path,
        packets.time_us * 1e-6,
        packets.channel,
        packets.subcarriers * _SPACING_HZ,
        left_out=packets.left_out,
    )


def check_tool(tool: str, mac: str | None = None, second: str | Path | None = None) -> None:
    """Refuse the name of a tool that is not known, and what does not go with it.

    Parameters
    ----------
    tool : str
    mac, second : optional
        As for :func:`open_csi`.

    Raises
    ------
    InputError

    Examples
    --------
    >>> check_tool("nexmon/4358/80")
    """
    chips = "|".join(_NEXMON_CHIPS)
    if not re.fullmatch(rf"intel|atheros|esp32|nexmon/({chips})/(20|40|80)", tool):
        raise InputError("--csi-tool", f"must be one of {', '.join(TOOLS)}", tool)
    if mac is not None:
        if tool in ("intel", "atheros"):
            raise InputError(
                "--mac", f"must not be given for {tool}, which records no senders", mac
            )
        if not re.fullmatch(r"[0-9a-fA-F]{2}(:[0-9a-fA-F]{2}){5}", mac):
            raise InputError("--mac", "must be like 11:22:33:44:55:66", mac)
    if second is not None and tool != "esp32":
        raise InputError("--second-antenna", "must not be given for other tools than esp32", tool)


def convert(path: str, tool: str, output: str, mac: str = "") -> None:
    """Convert a file to arrays, in a process of its own.

    Parameters
    ----------
    path : str
        File of the tool.
    tool : str
        As for :func:`open_csi`.
    output : str
        The .npz file to write.
    mac : str
        Of the sender that is wanted, for nexmon; the most frequent one where it is empty.

    Raises
    ------
    Exception
        Whatever csiread raises.

    Examples
    --------
    >>> convert("press.dat", "intel", "press.npz")  # doctest: +SKIP
    """
    name, *settings = tool.split("/")
    readers: dict[str, Callable[..., _Packets]] = {
        "intel": _intel,
        "atheros": _atheros,
        "nexmon": partial(_nexmon, mac),
    }
    found = readers[name](path, *settings)
    np.savez(
        output,
        time_s=found.time_s,
        channel=found.channel,
        subcarrier_hz=found.subcarriers * _SPACING_HZ,
        reasons=np.array([reason for reason, _ in found.left_out], str),
        counts=np.array([count for _, count in found.left_out], int),
    )


@dataclass(frozen=True, eq=False)
class _Packets:
    """Times in s, channels (n, K, A), subcarriers (K,), and what was left out."""

    time_s: np.ndarray
    channel: np.ndarray
    subcarriers: np.ndarray
    left_out: tuple[tuple[str, int], ...]


_OTHER = "packet with another number of antennas, streams or subcarriers"


def _intel(path: str) -> _Packets:
    from csiread import Intel

    # Four antennas instead of three: a broken permutation then stays inside the array.
    found = Intel(path, nrxnum=4, ntxnum=4, if_report=False)
    found.read()
    wide = (found.rate & _INTEL_WIDE > 0).astype(int)
    usual = _most_frequent(np.stack([found.Nrx, found.Ntx, wide], axis=1))
    subcarriers = _INTEL_40 if wide[usual].any() else _INTEL_20
    time_s = unwrapped(found.timestamp_low) * 1e-6
    lost = ((_OTHER, int(np.count_nonzero(~usual))),)
    return _Packets(time_s[usual], _used(found.csi[usual][..., 0]), subcarriers, lost)


def _atheros(path: str) -> _Packets:
    from csiread import Atheros

    most = Path(path).stat().st_size // _ATHEROS_BYTES + 1
    found = Atheros(path, nrxnum=3, ntxnum=3, tones=114, if_report=False, bufsize=most)
    found.read()
    filled = found.csi_len > 0
    usual = filled.copy()
    settings = np.stack([found.num_tones, found.nr, found.nc], axis=1)
    usual[filled] = _most_frequent(settings[filled])
    tones = int(np.max(found.num_tones[usual], initial=56))
    subcarriers = sent_subcarriers(64 if tones == 56 else 128)
    channel = _used(found.csi[usual][:, : len(subcarriers), :, 0])
    time_s = (found.timestamp[usual] - found.timestamp[:1]).astype(float) * 1e-6
    lost = (
        ("packet without CSI", int(np.count_nonzero(~filled))),
        (_OTHER, int(np.count_nonzero(filled & ~usual))),
    )
    return _Packets(time_s, channel, subcarriers, lost)


def _nexmon(mac: str, path: str, chip: str, mhz: str) -> _Packets:
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
    return _Packets(stamps[first][whole], channel[whole][:, subcarriers], subcarriers, lost)


def _grouped(core: np.ndarray, sequence: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Number of the packet of each core's frame, shape (n,).

    Some versions of the firmware report the sequence number 0 throughout. A packet is therefore new
    as well where a core reports again, or after half of the usual time between two of its reports.
    """
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
