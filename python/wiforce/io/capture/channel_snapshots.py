# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of channel snapshots that another device has measured: NumPy's .npz."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ..text.textfile import refuse_pipe

# Time that a clock is behind at most where stamps are merely out of order, in s: a host stamps
# packets when a program runs, up to some milliseconds late. Larger ones are steps of the clock.
_DISORDER_S = 0.01
# What remains unknown of the time when a clock has stepped back, in s: longer than the clock of a
# tag is predicted over a gap (20 s, estimation/clocks/clock_search.py), which is then acquired
# again.
CLOCK_STEP_S = 30.0
# Packets between two steps of a clock, on average, below which times are in no order at all.
_LEAST_BETWEEN = 64


def _ordered_times(path: Path, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Order of packets by time, rising times (n,), and how often the clock has stepped back."""
    times = time_s.astype(float)
    back = np.flatnonzero(np.diff(times) < -_DISORDER_S) + 1
    if len(back) and len(times) < _LEAST_BETWEEN * (len(back) + 1):
        row = int(back[0])
        rule = f"time_s[{row}]: must not lie before the packet before it, but for a few clock steps"
        raise InputError(path, rule, float(times[row]))
    later = np.zeros(len(times))
    later[back] = times[back - 1] - times[back] + CLOCK_STEP_S
    times = times + np.cumsum(later)
    order = np.argsort(times, kind="stable")
    return order, times[order], len(back)


_KEYS = ("time_s", "channel", "subcarrier_hz")
# Limits of what a file may hold: fewer subcarriers or packets give no reading, and no device has
# more subcarriers (802.11be, 320 MHz) or antennas.
LEAST_SUBCARRIERS, MOST_SUBCARRIERS = 4, 4096
LEAST_PACKETS, MOST_ANTENNAS = 64, 16
# Longest time without packets, after which a recording is none, and farthest subcarrier from the
# carrier, in Hz: that of no radio.
_LONGEST_GAP_S, _WIDEST_HZ = 3600.0, 1e10
# A subcarrier that is 0 in more packets than this part is a guard or pilot that is not reported.
_DEAD_SHARE = 0.5
# Noise changes magnitudes and phases alike. A subcarrier follows another one unless their phases
# part by this many times the ratio of their magnitudes, and by more than this angle in rad, both
# rms over the packets. An Intel AX200 has 2 rad at the pilots of 802.11n packets, where it reports
# another value than the channel, 0.4 to 1.4 rad at the lowest subcarriers of other packets, and
# 0.05 elsewhere, with magnitudes that part by 0.03. Neighbours that are compared, more than fade at
# once, and packets that are looked at.
_MORE_PHASE, _LEAST_RAD, _BESIDE, _MOST_COMPARED = 4.0, 0.2, 4, 4000
_REPEATED = "antenna with the values of another one"
_STRANGE = "subcarrier whose phase does not follow the others, such as pilots of an Intel AX200"


@dataclass(frozen=True, eq=False)
class ChannelSnapshots:
    """Channel snapshots as they are read: no packet twice, times not falling."""

    path: Path
    time_s: np.ndarray = field(repr=False)  # (n,), of each packet
    channel: np.ndarray = field(repr=False)  # (n, K, antennas), complex
    subcarrier_hz: np.ndarray = field(repr=False)  # (K,), against the carrier
    clock_steps: int = 0  # times at which the clock of the packets has stepped back; each is a gap
    left_out: tuple[tuple[str, int], ...] = ()  # what was, such as packets, and their number
    center_frequency_hz: float | None = None
    scene: Any = field(default=None, repr=False)  # that the file holds

    @property
    def notes(self) -> list[str]:
        """What was left out of the file, a sentence each."""
        found = []
        if self.clock_steps:
            times = "once" if self.clock_steps == 1 else f"{self.clock_steps} times"
            found.append(
                f"the clock of the packets stepped back {times}: each step is read as a gap of "
                f"{CLOCK_STEP_S:g} s, after which the tags' clocks are acquired again; times after "
                "it are not those since the start"
            )
        return [*found, *(f"left out {number} x {what}" for what, number in self.left_out)]

    @property
    def antennas(self) -> int:
        return int(self.channel.shape[2])

    @property
    def span_s(self) -> float:
        """Time from the first packet to the last one, in s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def received_s(self) -> float:
        """The same without the gaps that are assumed where its clock stepped back."""
        return self.span_s - CLOCK_STEP_S * self.clock_steps

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.path,)


def open_snapshots(path: str | Path) -> ChannelSnapshots:
    """Read a file of channel snapshots, or refuse one that is missing, broken or incomplete.

    Arrays ``time_s`` (N,), ``channel`` (N, K) or (N, K, antennas), ``subcarrier_hz`` (K,), perhaps
    ``center_frequency_hz`` and ``scene``.
    """
    path = Path(path)
    arrays = _arrays(path)
    missing = [name for name in _KEYS if name not in arrays]
    if missing:
        rule = f"must hold the arrays {', '.join(_KEYS)}; missing: {', '.join(missing)}"
        raise InputError(path, rule)
    return checked_snapshots(
        path,
        arrays["time_s"],
        arrays["channel"],
        arrays["subcarrier_hz"],
        _carrier(path, arrays.get("center_frequency_hz")),
        _scene(path, arrays.get("scene")),
    )


def checked_snapshots(
    path: Path,
    time_s: np.ndarray,
    channel: np.ndarray,
    subcarrier_hz: np.ndarray,
    center_frequency_hz: float | None = None,
    scene: Any = None,
    left_out: tuple[tuple[str, int], ...] = (),
) -> ChannelSnapshots:
    """Check arrays as :func:`open_snapshots`, leave out what cannot be used, and say why."""
    for violation in _violations(time_s, channel, subcarrier_hz):
        raise InputError(path, *violation)
    order, times, steps = _ordered_times(path, time_s)
    values = channel.reshape(len(times), len(subcarrier_hz), -1)[order]
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(values)
        # Only ratios matter: whatever the unit, squares must not overflow.
        middle = float(np.median(size[np.isfinite(size) & (size > 0)] if size.any() else 1.0))
        values = (values / (middle or 1.0)).astype(np.complex64)
        power = np.sum(np.abs(values) ** 2, axis=(1, 2), dtype=float)
    usable = np.isfinite(power) & (power > 0)
    # A device reports a packet again with the same values. The same time says nothing: it may be
    # rounded.
    same = np.all(values[1:] == values[:-1], axis=(1, 2))
    again = np.concatenate([[False], same]) & usable
    kept = usable & ~again
    _check_enough(path, kept, LEAST_PACKETS, "packets or more that differ and are finite")
    times, values = times[kept], values[kept]
    # Of two antennas that were stored with the same values, the second says nothing.
    antennas: list[int] = []
    for antenna in range(values.shape[2]):
        values_of_one = values[:, :, antenna]
        if not any(np.array_equal(values_of_one, values[:, :, other]) for other in antennas):
            antennas.append(antenna)
    repeated, values = values.shape[2] - len(antennas), values[:, :, antennas]
    alive = np.mean(np.abs(values).min(axis=2) == 0, axis=0) <= _DEAD_SHARE
    rule = "subcarriers or more on which every antenna receives something"
    _check_enough(path, alive, LEAST_SUBCARRIERS, rule)
    values, hertz = values[:, alive], subcarrier_hz.astype(float)[alive]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        own = _following(values, hertz)
    _check_enough(path, own, LEAST_SUBCARRIERS, "subcarriers or more whose phases follow others")
    lost = (
        ("repeated packet", int(again.sum())),
        ("packet without finite values", int((~usable).sum())),
        *left_out,
        (_REPEATED, repeated),
        (_STRANGE, int((~own).sum())),
    )
    lost = tuple(each for each in lost if each[1])
    values, hertz = values[:, own], hertz[own]
    return ChannelSnapshots(path, times, values, hertz, steps, lost, center_frequency_hz, scene)


def _check_enough(path: Path, kept: np.ndarray, least: int, what: str) -> None:
    """Refuse a channel that keeps fewer packets or subcarriers."""
    if kept.sum() < least:
        raise InputError(path, f"channel: must hold {least} {what}", int(kept.sum()))


def _following(channel: np.ndarray, subcarrier_hz: np.ndarray) -> np.ndarray:
    """Subcarriers (K,) of channels (n, K, A) whose phases follow one another, or all."""
    order = np.argsort(subcarrier_hz)
    some = channel[:: max(1, len(channel) // _MOST_COMPARED), order]
    hertz = subcarrier_hz[order]
    pairs = some[:, 1:] * some[:, :-1].conj()
    beside = np.diff(hertz) < 1.01 * np.diff(hertz).min()
    slope = np.angle(pairs[:, beside].sum(axis=(1, 2))) / np.diff(hertz).min()
    some = some * np.exp(-1j * np.multiply.outer(slope, hertz))[:, :, None]
    turn, level = np.exp(1j * np.angle(some)), np.log(np.maximum(np.abs(some), 1e-30))
    group = np.arange(len(order))
    for lag in range(1, min(_BESIDE, len(order) - 1) + 1):
        along = np.abs(np.mean(turn[:, lag:] * turn[:, :-lag].conj(), axis=0))
        phase = np.sqrt(-2 * np.log(np.clip(along, 1e-30, 1)))
        allowed = np.maximum(
            _MORE_PHASE * np.std(level[:, lag:] - level[:, :-lag], axis=0), _LEAST_RAD
        )
        for first in np.flatnonzero((phase <= allowed).any(axis=1)):
            group[group == group[first + lag]] = group[first]
    largest = np.bincount(group).argmax()
    own = np.ones(len(order), bool)
    if 2 * np.count_nonzero(group == largest) > len(order):
        own[order] = group == largest
    return own


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file that are looked at, and nothing that would be executed."""
    if path.is_dir():
        raise InputError(path, "is a folder; name the .npz file in it")
    refuse_pipe(path)
    try:
        with path.open("rb") as file:
            start = file.read(6)
        if start == b"\x93NUMPY":
            raise InputError(path, "is a single array; write it with numpy.savez")
        if not start.startswith(b"PK"):
            raise InputError(path, "is broken, or no .npz file of NumPy")
        with np.load(path, allow_pickle=False) as opened:
            wanted = (*_KEYS, "center_frequency_hz", "scene")
            return {name: opened[name] for name in wanted if name in opened.files}
    except InputError:
        raise
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or 'it is truncated'})") from error
    except Exception as error:  # damaged zip files raise anything from zlib.error to RuntimeError
        rule = "is broken, or no .npz file of NumPy"
        if isinstance(error, ValueError) and "pickle" in str(error).lower():
            rule = "holds Python objects (pickles), which are not loaded; write plain arrays"
        raise InputError(path, rule) from error


def _violations(
    time_s: np.ndarray, channel: np.ndarray, subcarrier_hz: np.ndarray
) -> Iterator[tuple[Any, ...]]:
    """What is wrong with the arrays: a rule, and perhaps the value."""
    if time_s.ndim != 1 or time_s.dtype.kind not in "fiu":
        yield "time_s: must be one real number per packet", _kind(time_s)
    if subcarrier_hz.ndim != 1 or subcarrier_hz.dtype.kind not in "fiu":
        yield "subcarrier_hz: must be one real number per subcarrier", _kind(subcarrier_hz)
    if channel.ndim not in (2, 3) or channel.dtype.kind != "c":
        rule = "channel: must be complex, packets by subcarriers, or by subcarriers and antennas"
        yield rule, _kind(channel)
    packets, subcarriers, *antennas = channel.shape
    if packets != len(time_s):
        yield f"channel: must have as many packets as time_s ({len(time_s)})", channel.shape
    if subcarriers != len(subcarrier_hz):
        count = len(subcarrier_hz)
        yield f"channel: must have as many subcarriers as subcarrier_hz ({count})", channel.shape
    if antennas and not 1 <= antennas[0] <= MOST_ANTENNAS:
        yield f"channel: must have 1 to {MOST_ANTENNAS} antennas", antennas[0]
    if not LEAST_SUBCARRIERS <= subcarriers <= MOST_SUBCARRIERS:
        yield (
            f"subcarrier_hz: must hold {LEAST_SUBCARRIERS} to {MOST_SUBCARRIERS} subcarriers",
            subcarriers,
        )
    if packets < LEAST_PACKETS:
        yield f"time_s: must hold {LEAST_PACKETS} packets or more", packets
    if channel.real.any() and not channel.imag.any():
        yield ("channel: must hold phases, but all imaginary parts are 0",)
    if not np.isfinite(time_s).all():
        row = int(np.flatnonzero(~np.isfinite(time_s))[0])
        yield f"time_s[{row}]: must be finite", float(time_s[row])
    if not time_s.max() > time_s.min():
        yield "time_s: must not be the same for all packets", float(time_s[0])
    gaps = np.flatnonzero(np.diff(time_s.astype(float)) > _LONGEST_GAP_S)
    if gaps.size:
        row = int(gaps[0]) + 1
        rule = (
            f"time_s[{row}]: must lie at most {_LONGEST_GAP_S:g} s after the packet before it; "
            "times are in seconds"
        )
        yield rule, float(time_s[row])
    wide = np.flatnonzero(~(np.abs(subcarrier_hz.astype(float)) <= _WIDEST_HZ))
    if wide.size:
        rule = f"subcarrier_hz[{wide[0]}]: must be a number of at most {_WIDEST_HZ:g} Hz"
        yield rule, float(subcarrier_hz[wide[0]])
    if len(np.unique(subcarrier_hz)) < subcarriers:
        yield ("subcarrier_hz: must differ from subcarrier to subcarrier",)


def _kind(array: np.ndarray) -> str:
    return f"{array.dtype} of shape {array.shape}"


def _carrier(path: Path, value: np.ndarray | None) -> float | None:
    if value is None:
        return None
    if value.ndim or value.dtype.kind not in "fiu" or not np.isfinite(value) or value <= 0:
        rule = "center_frequency_hz: must be a number above 0"
        raise InputError(path, rule, value.tolist() if value.size < 9 else _kind(value))
    return float(value)


def _scene(path: Path, value: np.ndarray | None) -> Any:
    if value is None:
        return None
    if value.ndim or value.dtype.kind != "U":
        raise InputError(path, "scene: must be a text (JSON)", _kind(value))
    try:
        return json.loads(str(value))
    except (ValueError, RecursionError) as error:
        raise InputError(path, "scene: is not JSON") from error
