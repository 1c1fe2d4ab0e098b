# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the common CSI tools, through the optional package csiread.

csiread parses them in C without checks of lengths: a damaged file may end the process that reads
it. It therefore runs in a process of its own.
"""

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import InputError
from .channel_snapshots import ChannelSnapshots, checked_snapshots
from .optional import check_installed

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
# Device clocks of 32 bits, in microseconds.
_WRAP = 1 << 32
# Longest time that a conversion may take, in s: a file of 1 GB takes about one minute.
_LONGEST_S = 600
_CHILD = (
    "import sys; from gnuradio.wiforce.io.csi_tools import convert; "
    "convert(sys.argv[1], sys.argv[2], sys.argv[3])"
)


def open_csi(path: str | Path, tool: str) -> ChannelSnapshots:
    """Read a file of a CSI tool.

    Parameters
    ----------
    path : str or Path
    tool : str
        ``intel`` (Linux 802.11n CSI Tool, Intel 5300), ``atheros`` (Atheros CSI Tool), ``esp32``
        (ESP32-CSI-Tool, one antenna) or ``nexmon/CHIP/MHZ`` (nexmon_csi, such as
        ``nexmon/43455c0/80``).

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
    check_tool(tool)
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "is not a file, or does not exist")
    check_installed(path, ["csiread"])
    with tempfile.TemporaryDirectory(prefix=".csi-") as folder:
        output = Path(folder) / "csi.npz"
        command = [sys.executable, "-c", _CHILD, str(path.resolve()), tool, str(output)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S)
        except subprocess.TimeoutExpired as error:
            raise InputError(path, f"takes csiread longer than {_LONGEST_S} s") from error
        if done.returncode or not output.exists():
            said = done.stderr.strip().splitlines()
            reason = said[-1] if said and done.returncode > 0 else "its parser crashed"
            raise InputError(path, f"cannot be read by csiread as a file of {tool} ({reason})")
        with np.load(output, allow_pickle=False) as arrays:
            return checked_snapshots(
                path, arrays["time_s"], arrays["channel"], arrays["subcarrier_hz"]
            )


def check_tool(tool: str) -> None:
    """Refuse the name of a tool that is not known.

    Parameters
    ----------
    tool : str

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


def convert(path: str, tool: str, output: str) -> None:
    """Convert a file to arrays, in a process of its own.

    Parameters
    ----------
    path : str
        File of the tool.
    tool : str
        As for :func:`open_csi`.
    output : str
        The .npz file to write.

    Raises
    ------
    Exception
        Whatever csiread raises.

    Examples
    --------
    >>> convert("press.dat", "intel", "press.npz")  # doctest: +SKIP
    """
    name, *settings = tool.split("/")
    readers: dict[str, Callable[..., _Arrays]] = {
        "intel": _intel,
        "atheros": _atheros,
        "esp32": _esp32,
        "nexmon": _nexmon,
    }
    time_s, channel, subcarriers = readers[name](path, *settings)
    np.savez(output, time_s=time_s, channel=channel, subcarrier_hz=subcarriers * _SPACING_HZ)


_Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


def _intel(path: str) -> _Arrays:
    from csiread import Intel

    # Four antennas instead of three: a broken permutation then stays inside the array.
    found = Intel(path, nrxnum=4, ntxnum=4, if_report=False)
    found.read()
    subcarriers = _INTEL_40 if np.mean(found.rate & _INTEL_WIDE > 0) > 0.5 else _INTEL_20
    return _unwrapped_s(found.timestamp_low), _used(found.csi[..., 0]), subcarriers


def _atheros(path: str) -> _Arrays:
    from csiread import Atheros

    most = Path(path).stat().st_size // _ATHEROS_BYTES + 1
    found = Atheros(path, nrxnum=3, ntxnum=3, tones=114, if_report=False, bufsize=most)
    found.read()
    tones = int(np.max(found.num_tones, initial=0))
    kept = (found.num_tones == tones) & (found.csi_len > 0)
    edge = 28 if tones == 56 else 58
    inner = 1 if tones == 56 else 2
    subcarriers = np.r_[-edge : -inner + 1, inner : edge + 1]
    channel = _used(found.csi[kept][:, : len(subcarriers), :, 0])
    return found.timestamp[kept].astype(float) * 1e-6, channel, subcarriers


def _esp32(path: str) -> _Arrays:
    from csiread import ESP32

    found = ESP32(path, if_report=False)
    found.read()
    values = np.asarray(found.csi)
    count = values.shape[1] // (1 if np.iscomplexobj(values) else 2)
    if not np.iscomplexobj(values):  # pairs of imaginary and real part
        values = values[:, 1::2] + 1j * values[:, ::2]
    subcarriers = np.fft.fftfreq(count, 1 / count)
    return _unwrapped_s(np.asarray(found.local_timestamp)), values[:, :, None], subcarriers


def _nexmon(path: str, chip: str, mhz: str) -> _Arrays:
    from csiread import Nexmon

    found = Nexmon(path, chip=chip, bw=int(mhz), if_report=False)
    found.read()
    time_s = found.sec + found.usec * (1e-9 if found.nano else 1e-6)
    # A packet is reported once per core, which is an antenna, and spatial stream.
    own = np.flatnonzero(found.spatial == 0)
    cores = np.unique(found.core[own])
    new = np.concatenate([[True], np.diff(found.seq[own]) != 0])
    rows, place = np.cumsum(new) - 1, np.searchsorted(cores, found.core[own])
    shape = int(rows.max(initial=-1)) + 1, found.csi.shape[1], len(cores)
    channel, seen = np.zeros(shape, complex), np.zeros((shape[0], len(cores)), bool)
    channel[rows, :, place] = found.csi[own]
    seen[rows, place] = True
    whole = seen.all(axis=1)
    count = found.csi.shape[1]
    return time_s[own][new][whole], channel[whole], np.fft.fftfreq(count, 1 / count)


def _used(channel: np.ndarray) -> np.ndarray:
    """Antennas that most packets hold."""
    power = np.mean(np.abs(channel).sum(axis=1) > 0, axis=0)
    return channel[:, :, power > 0.5]


def _unwrapped_s(microseconds: np.ndarray) -> np.ndarray:
    """Times in s of a clock of 32 bits that wraps."""
    steps = np.diff(microseconds.astype(np.int64))
    later = (steps + _WRAP // 2) % _WRAP - _WRAP // 2
    return np.concatenate([[0.0], np.cumsum(later) * 1e-6])
