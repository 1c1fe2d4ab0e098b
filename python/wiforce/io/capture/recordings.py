# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings on disk: SigMF pairs and raw sample files, checked before anything is read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import InputError
from ...signal.carrier import same_carrier
from .names import SUFFIXES, files_of, stem_of
from .samples import DATATYPES, holds_text, samples_of
from .sigmf_metadata import read_metadata

if TYPE_CHECKING:
    from ...scene import Scene

# A day at 12.5 Msps. Each group of a gap is a row, which fill the memory beyond.
_MOST_LOST = 2**40


class EmptyCapture(InputError):
    """A file of samples holds none yet."""


class Segment(NamedTuple):
    """A run of samples without a gap."""

    file_sample: int  # its first sample, counted from the beginning of the file
    global_index: int  # the same sample on the device's count, which goes on during gaps
    length: int
    retuned: bool = False  # the device was retuned or opened again before it


@dataclass(frozen=True)
class Capture:
    """A checked recording."""

    path: Path  # the data file
    datatype: str  # ``ci16_le`` or ``cf32_le``
    sample_rate_hz: float | None
    center_frequency_hz: float | None
    segments: tuple[Segment, ...]  # in order of time; a gap or a retuning lies between two of them
    # That the metadata hold (``wiforce:scene``), unchecked.
    scene: Any = field(default=None, repr=False, compare=False)
    # Of the data file as the metadata state it (``core:sha512``), not verified.
    sha512: str | None = field(default=None, repr=False, compare=False)
    # Samples that the metadata state (``wiforce:samples``, or where the last capture begins).
    stated_samples: int = field(default=0, repr=False, compare=False)

    @property
    def samples(self) -> int:
        """Number of samples in the file."""
        return sum(segment.length for segment in self.segments)

    @property
    def gaps(self) -> int:
        """Number of places where samples were lost."""
        ends = [segment.global_index + segment.length for segment in self.segments]
        return sum(end < of.global_index for end, of in zip(ends, self.segments[1:], strict=False))

    @property
    def incomplete(self) -> str:
        """A sentence if the file ends before what its metadata state, or within a sample."""
        if lacking := max(0, self.stated_samples - self.samples):
            return (
                f"ends {lacking} samples before the {self.stated_samples} that its metadata state: "
                "only a part of it is read; was it copied completely, or is it still written?"
            )
        if cut := self.path.stat().st_size % DATATYPES[self.datatype].sample_bytes:
            left = "1 byte is" if cut == 1 else f"{cut} bytes are"
            return f"ends within a sample, of which {left} left out; is it whole?"
        return ""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the recording that exist, those of a second antenna included."""
        return files_of(self.path)

    @property
    def span(self) -> int:
        """Number of samples from the first to the last, those lost in gaps included."""
        first, last = self.segments[0], self.segments[-1]
        return last.global_index + last.length - first.global_index

    def read(self, count: int) -> np.ndarray:
        """Read the first samples of the file, at most ``count``; full scale is 1 per component."""
        return self._read_file(0, count)

    def read_span(self, start: int, count: int) -> np.ndarray:
        """Samples by their time on the device from the first on, zeros in gaps; full scale 1."""
        samples = np.zeros(max(0, min(count, self.span - start)), np.complex64)
        for segment in self.segments:
            offset = segment.global_index - self.segments[0].global_index - start
            first, last = max(0, -offset), min(segment.length, len(samples) - offset)
            if first < last:
                part = self._read_file(segment.file_sample + first, last - first)
                if len(part) == len(samples):
                    return part
                samples[offset + first : offset + first + len(part)] = part
        return samples

    def _read_file(self, start: int, count: int) -> np.ndarray:
        offset = start * DATATYPES[self.datatype].sample_bytes
        if self.datatype == "cf32_le":
            return np.fromfile(self.path, "<c8", count, offset=offset)
        codes = np.fromfile(self.path, "<i2", 2 * count, offset=offset)
        return samples_of(codes[: len(codes) // 2 * 2])

    def check_against(self, scene: "Scene") -> None:
        """Refuse a scene whose sample rate or carrier differs, with both values."""
        own, wanted = self.sample_rate_hz, scene.radio.sample_rate_hz
        if own is not None and abs(own - wanted) > 1e-6 * wanted:
            rule = f"sample rate must be radio.sample_rate_hz of the scene ({wanted:.12g} Hz)"
            raise InputError(self.path, rule, own)
        own, wanted = self.center_frequency_hz, scene.radio.center_frequency_hz
        if own is not None and not same_carrier(own, wanted):
            rule = f"carrier must be radio.center_frequency_hz of the scene ({wanted:.12g} Hz)"
            raise InputError(self.path, rule, own)


def open_capture(path: str | Path, datatype: str | None = None) -> Capture:
    """Open a SigMF capture by a file's name or stem, or raw samples of a ``datatype``."""
    if not isinstance(path, str | Path):
        raise InputError("capture", "must be the path of a capture", path)
    path = Path(path)
    if not path.name:
        raise InputError(repr(str(path)), "is not the name of a capture")
    if datatype is not None:
        return _open_raw(path, datatype)
    if path.is_dir() and not path.with_name(f"{path.name}.sigmf-meta").exists():
        rule = "is a folder; name a file of the capture in it, or the part that both have in common"
        raise InputError(path, rule)
    data, meta = (Path(stem_of(path) + suffix) for suffix in SUFFIXES)
    if path.is_file() and not meta.is_file():
        rule = (
            f"is not a capture: there is no {meta.name}; for raw samples, give their type "
            "(--datatype ci16_le or cf32_le) and scene (--scene)"
        )
        if path.suffix == ".npz":
            rule = "holds channel snapshots, which only `read` and `check` take; this needs samples"
        elif holds_text(path):
            rule = "holds text, not samples; `export`, `score` and `watch` take files of readings"
        raise InputError(path, rule)
    for file in (meta, data):
        _check_file(file)
    return _open_sigmf(meta, data)


def _open_raw(path: Path, datatype: str) -> Capture:
    if datatype not in DATATYPES:
        raise InputError("datatype", f"must be one of {', '.join(DATATYPES)}", datatype)
    meta = path.with_name(f"{path.name}.sigmf-meta")
    if not path.exists() and meta.exists():
        raise InputError(path, f"no such file; {meta.name} states its own type: omit --datatype")
    _check_file(path)
    samples = _count(path, datatype, path.stat().st_size)
    return Capture(path, datatype, None, None, (Segment(0, 0, samples),))


def _check_file(path: Path) -> None:
    if not path.exists():
        raise InputError(path, "no such file")
    # The samples are read from several places of the file at once, as no pipe allows.
    if not path.is_file():
        raise InputError(path, "must be a regular file; a folder or a pipe cannot be read")


def _count(path: Path, datatype: str, size: int) -> int:
    sample_bytes = DATATYPES[datatype].sample_bytes
    if size < sample_bytes:
        raise EmptyCapture(path, "is empty")
    return size // sample_bytes


def _open_sigmf(meta: Path, data: Path) -> Capture:
    # The size is taken first: while a recorder writes, metadata read later then covers every gap
    # in the samples counted here.
    size = data.stat().st_size
    fields, captures = read_metadata(meta)
    datatype = fields.get("core:datatype")
    if datatype not in DATATYPES:
        rule = f"core:datatype must be one of {', '.join(DATATYPES)}"
        raise InputError(meta, rule, datatype)
    _check_stated(meta, fields, "core:num_channels", 1)
    # Samples of another file are not read.
    _check_stated(meta, fields, "core:dataset", data.name)
    _check_stated(meta, fields, "core:trailing_bytes", 0)
    total = _count(data, datatype, size)
    rate = _positive(meta, "core:sample_rate", fields.get("core:sample_rate"))
    carriers = [c["core:frequency"] for c in captures if "core:frequency" in c]
    carrier = _positive(meta, "core:frequency", carriers[0]) if carriers else None
    for other in carriers:
        if other != carriers[0]:
            raise InputError(meta, "core:frequency must be the same in all captures", other)
    segments = _segments(meta, captures, total)
    scene, sha512 = fields.get("wiforce:scene"), fields.get("core:sha512")
    last = captures[-1]["core:sample_start"] if captures else 0
    stated = max(fields.get("wiforce:samples", 0), last)
    return Capture(data, datatype, rate, carrier, segments, scene, sha512, stated)


def _check_stated(meta: Path, fields: Mapping[str, Any], name: str, readable: int | str) -> None:
    """Refuse a field that states anything else than what can be read."""
    if fields.get(name, readable) != readable:
        raise InputError(meta, f"{name} must be {readable}", fields[name])


def _positive(meta: Path, name: str, value: Any) -> float:
    if value is None or value <= 0:
        raise InputError(meta, f"{name} must be a positive number", value)
    return float(value)


def _segments(meta: Path, captures: Sequence[Mapping[str, Any]], total: int) -> tuple[Segment, ...]:
    """Runs of samples between gaps and retunings; other contiguous captures are merged."""
    captures = captures or [{"core:sample_start": 0}]
    starts = [capture["core:sample_start"] for capture in captures]
    ends = [*starts[1:], max(total, starts[-1])]
    segments: list[Segment] = []
    retuned = False  # since the last segment
    for capture, start, end in zip(captures, starts, ends, strict=True):
        _check_stated(meta, capture, "core:header_bytes", 0)
        last = segments[-1] if segments else Segment(start, start, 0)
        expected = last.global_index + (start - last.file_sample)
        index = capture.get("core:global_index", expected)
        # A truncated file keeps the captures that it still holds.
        length = min(end, total) - start
        retuned |= capture.get("wiforce:retuned", False)
        if length <= 0:
            continue
        lost = index - (last.global_index + last.length)
        if segments and lost < 0:
            raise InputError(meta, "core:global_index must not decrease", index)
        if segments and lost > _MOST_LOST:
            raise InputError(meta, "core:global_index must not jump by over 2^40 samples", index)
        if segments and lost == 0 and not retuned:
            segments[-1] = last._replace(length=last.length + length)
        else:
            segments.append(Segment(start, index, length, retuned))
        retuned = False
    if not segments:
        raise InputError(meta, "no capture lies inside the data file", total)
    return tuple(segments)
