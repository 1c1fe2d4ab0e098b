# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures in files, as sources and sinks of samples."""

import errno
import os
import threading
import time
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.capture.folded_groups import frame_settings
from ..estimation.capture.recorded_frames import capture_problem
from ..estimation.groups import Array
from ..io.capture.names import recording_stem
from ..io.capture.recordings import Capture, open_capture
from ..io.capture.samples import DATATYPES, item_type_named
from ..io.readings import written_utc
from ..io.text.textfile import check_output, write_whole
from ..scene import Scene, load_scene
from ..wiforce_python import recording_source, rx_time_value
from . import names
from .argument_types import Kept, typed
from .stream_watch import DeviceSettings, Timeline, between_tags, time_value


@typed
def capture_source(
    recording: str | Path | Capture,
    scene: str | Path | dict[str, Any] | Scene,
    frame_offset: int = 0,
    datatype: str | None = None,
) -> recording_source:
    """A ``recording_source`` for a capture of a scene.

    Output: one vector of a symbol's samples per frame, for a ``reader`` with the input ``folded``.
    Where the capture does not begin with frames at ``frame_offset``, a warning names the cause.

    Parameters
    ----------
    recording : str, Path or Capture
        SigMF pair, by either file's name or their common stem; raw samples with ``datatype``.
    scene : str, Path, dict or Scene
        Defines the sounding frame; must agree with the capture on sample rate and carrier.
    frame_offset : int
        Samples before the first frame.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.

    Returns
    -------
    recording_source

    Raises
    ------
    InputError
        Naming file, rule and value, when a file is missing, broken, or contradicts the scene.

    Examples
    --------
    >>> source = capture_source("press", "demo")  # doctest: +SKIP
    """
    if frame_offset < 0:
        raise InputError("frame_offset", "must be 0 or more", frame_offset)
    if not isinstance(recording, Capture):
        recording = open_capture(recording, datatype)
    scene = load_scene(scene)
    recording.check_against(scene)
    waveform = scene.waveform()
    shared = scene.environment.receive_antennas == 1 and scene.environment.reader_clock == "shared"
    if shared and (problem := capture_problem(recording, waveform, frame_offset)):
        gr.log.warn(f"capture_source: {problem}")
    return recording_source(**frame_settings(recording, waveform, frame_offset))


_RX_TIME = pmt.intern(names.RX_TIME)
# Interval at which the file is checked for new samples.
_POLL_S = 0.1


class capture_stream(Kept, gr.sync_block):
    """Samples of a growing capture, ``sc16`` or ``fc32``, with ``rx_time`` at start and gaps.

    A gap must be in the metadata before the samples behind it; one reported later, or another rate
    or carrier, ends the stream with a ``failure``. ``ended`` ends it with the file.
    """

    @typed
    def __init__(
        self, path: str | Path, datatype: str | None = None, sample_rate: float = 12.5e6
    ) -> None:
        self._source = (path, datatype)
        self._rate = sample_rate
        self._known = open_capture(path, datatype)
        kind = DATATYPES[self._known.datatype]
        self.item_type, self._sample_bytes = kind.name, kind.sample_bytes
        gr.sync_block.__init__(self, "capture_stream", in_sig=None, out_sig=[kind.item])
        self.ended = threading.Event()
        self.failure: Exception | None = None
        self._file = open(self._known.path, "rb", buffering=0)
        self._segment, self._at = 0, self._known.segments[0].file_sample

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        out = output_items[0]
        try:
            count = min(len(out), self._available())
            if count == 0:
                ended = self.ended.is_set()
                if not self._reopen():
                    if ended:
                        return -1
                    time.sleep(_POLL_S)
                return 0
            self._tag_segment()
            count = self._read(out[:count])
        except (InputError, OSError) as error:
            self.failure = error
            return -1
        self._at += count
        return count

    def stop(self) -> bool:
        self._file.close()
        return super().stop()

    def _available(self) -> int:
        """Samples available of the present segment; moves on to the next when it has ended."""
        segments = self._known.segments
        segment = segments[self._segment]
        if self._at == segment.file_sample + segment.length and self._segment + 1 < len(segments):
            self._segment += 1
            segment = segments[self._segment]
            self._at = segment.file_sample
        return segment.file_sample + segment.length - self._at

    def _reopen(self) -> bool:
        """Whether the capture has grown. Its size is read before its metadata."""
        known, self._known = self._known, open_capture(*self._source)
        if self._known.samples < known.samples:
            raise InputError(self._known.path, "was cut short while it was read")
        self._check_unchanged(known)
        return self._known.samples > known.samples

    def _check_unchanged(self, known: Capture) -> None:
        """Refuse metadata that contradict what has been sent."""
        for what, before, now in (
            ("datatype", known.datatype, self._known.datatype),
            ("sample rate", known.sample_rate_hz, self._known.sample_rate_hz),
            ("carrier", known.center_frequency_hz, self._known.center_frequency_hz),
        ):
            if before is not None and now != before:
                rule = f"{what} must not change while the capture is read, was {before}"
                raise InputError(self._known.path, rule, now)
        sent, stated = self._times(known), self._times(self._known)
        if sent != stated:
            late = next((time[0] for time in stated if time not in sent), self._at)
            rule = (
                f"metadata report a gap at sample {late} only after that sample was read (a "
                "recorder must write its metadata first)"
            )
            raise InputError(self._known.path, rule)

    def _times(self, capture: Capture) -> list[tuple[int, int]]:
        """First sample and device count of the segments that have been sent."""
        return [
            (segment.file_sample, segment.global_index)
            for segment in capture.segments
            if segment.file_sample < self._at
        ]

    def _tag_segment(self) -> None:
        segment = self._known.segments[self._segment]
        if self._at != segment.file_sample:
            return
        since = segment.global_index - self._known.segments[0].global_index
        whole = int(since // self._rate)
        value = time_value(whole, since / self._rate - whole)
        self.add_item_tag(0, self.nitems_written(0), _RX_TIME, value)
        if segment.retuned:
            retuned = pmt.intern(names.RETUNED)
            self.add_item_tag(0, self.nitems_written(0), retuned, pmt.from_uint64(1))

    def _read(self, out: Array) -> int:
        place = self._at * self._sample_bytes
        read = os.preadv(self._file.fileno(), [out.view(np.uint8).data], place)
        if read < out.nbytes:
            raise InputError(self._known.path, "was cut short while it was read")
        return len(out)


class sample_keeper(Kept, gr.sync_block):
    """Keeps the first ``count`` 16-bit samples, (n, 2), without ever ending the flowgraph."""

    @typed
    def __init__(self, count: int) -> None:
        gr.sync_block.__init__(self, "sample_keeper", in_sig=[(np.int16, 2)], out_sig=None)
        self._kept, self._count = np.empty((count, 2), np.int16), 0

    @property
    def samples(self) -> Array:
        return self._kept[: self._count]

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        items = input_items[0]
        part = items[: len(self._kept) - self._count]
        self._kept[self._count : self._count + len(part)] = part
        self._count += len(part)
        return len(items)


# A device's clock this near to the host's is UTC; one that was not set counts from its start and
# is decades off, so that half and twice as much decide alike.
_UTC_WITHIN_S = 1800.0


class sigmf_recorder(Kept, gr.sync_block):
    """Writes ``PATH.sigmf-data`` and ``PATH.sigmf-meta`` while samples come in.

    Samples are written as they arrive and the metadata is replaced as a whole, so that the
    recording can be read at any time, also after a crash. Where ``rx_time`` reports lost samples, a
    new entry of ``captures`` begins, whose ``core:global_index`` jumps; so does one where the
    device was opened or tuned again, with ``wiforce:retuned``. Samples that ``rx_rate`` or
    ``rx_freq`` say have another rate, or another carrier than those before, are left out, as in
    ``preamble_fold``.

    A flowgraph that is started again continues the recording if its first ``rx_time`` reports the
    samples lost in between; otherwise the recording stops.

    ``core:datetime`` is when the first sample was received by ``rx_time``, where that plus
    ``utc_offset_s`` is within half an hour of the host's clock, and otherwise when it arrived here,
    which buffers delay. Later entries count on from it.

    Where no sample came, no file is left. Else ``wiforce:samples`` states their number at the end.

    A disk error stops the recording, not the flowgraph: see ``failure``.

    Input: samples, complex or complex 16-bit integers.

    Parameters
    ----------
    path : str or Path
        ``.sigmf-data`` or ``.sigmf-meta`` at its end is left out. Nothing is overwritten.
    sample_rate : float
        Samples per second.
    center_frequency : float
        Carrier in Hz; the metadata state the one that ``rx_freq`` reports, with a warning where it
        is not within 0.1 %.
    item_type : str
        ``fc32`` or ``sc16``.
    fields : dict, optional
        Further entries of the metadata's ``global`` object: ``core:hw``, ``wiforce:scene``, ...

    Attributes
    ----------
    failure : OSError or None
        The error that stopped the recording.
    utc_offset_s : float
        UTC less the device's time, in s; 0 unless it is set, at any time before the end.

    Raises
    ------
    InputError
        (A ValueError) for files that exist already or cannot be written, and bad parameters.

    Examples
    --------
    >>> recorder = sigmf_recorder("press", item_type="sc16", fields={"core:hw": "N210"})
    """

    @typed
    def __init__(
        self,
        path: str | Path,
        sample_rate: float = 12.5e6,
        center_frequency: float = 900e6,
        item_type: str = "fc32",
        fields: dict[str, Any] | None = None,
    ) -> None:
        from .._config import VERSION

        kind = item_type_named(item_type)
        if not sample_rate > 0:
            raise InputError("sample_rate", "must be positive", sample_rate)
        if not center_frequency > 0:
            raise InputError("center_frequency", "must be positive", center_frequency)
        gr.sync_block.__init__(self, "sigmf_recorder", in_sig=[kind.item], out_sig=None)
        self.failure: OSError | None = None
        self.utc_offset_s = 0.0
        self._rate = sample_rate
        self._settings = DeviceSettings("sigmf_recorder", sample_rate, center_frequency)
        self._first_s: float | None = None  # device time of the first item, and host's
        self._arrived_s = 0.0
        self._timeline = Timeline(sample_rate)
        self._captures: list[dict[str, Any]] = []
        self._passed = self._recorded = 0  # items, in all runs
        # Whether the next sample begins an entry of the metadata, and what is known of it.
        self._begins, self._retuned, self._resumes = True, False, False
        self._global = {
            "core:datatype": kind.datatype,
            "core:sample_rate": sample_rate,
            "core:version": "1.0.0",
            "core:num_channels": 1,
            "core:extensions": [{"name": "wiforce", "version": VERSION, "optional": True}],
            **(fields or {}),
        }
        stem = recording_stem(path, "path")
        self._meta, self._data = Path(f"{stem}.sigmf-meta"), Path(f"{stem}.sigmf-data")
        _check_new(self._meta, self._data)
        self._file: FileIO | None = None

    @typed
    def describe(self, fields: dict[str, Any]) -> None:
        """Add entries to the metadata's ``global`` object, written with the next capture.

        Parameters
        ----------
        fields : dict
            ``core:hw``, ...
        """
        self._global |= fields

    def start(self) -> bool:
        # GNU Radio counts items from 0 whenever a flowgraph starts, not so after unlock().
        self._resumes = self.nitems_read(0) == 0 < self._recorded
        try:
            self._file = open(self._data, "xb" if self._file is None else "ab", buffering=0)
        except OSError as error:
            self._stop_recording(error)
        return super().start()

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        items = input_items[0]
        if self.failure is None and self._file is not None:
            try:
                self._take(self._file, np.ascontiguousarray(items))
            except OSError as error:
                self._stop_recording(error)
        return len(items)

    def stop(self) -> bool:
        if self._file is not None:
            self._file.close()
            self._complete()
        return super().stop()

    def _complete(self) -> None:
        """State the length, by which a copy that was cut is known; leave no empty file."""
        try:
            # A write that failed may have written a part.
            size = self._data.stat().st_size
            if size:
                sample_bytes = DATATYPES[self._global["core:datatype"]].sample_bytes
                self._global["wiforce:samples"] = size // sample_bytes
                self._write_metadata()
            else:
                self._data.unlink()
                self._meta.unlink(missing_ok=True)
                self._file = None
                self._captures.clear()
                self._begins = True
        except OSError as error:
            if self.failure is None:
                self._stop_recording(error)

    def _stop_recording(self, error: OSError) -> None:
        self.failure = error
        gr.log.error(f"sigmf_recorder: {self._data}: {error.strerror}; recording stopped")

    def _take(self, file: FileIO, items: Array) -> None:
        """Record items as their tags say, each run behind its entry of the metadata."""
        if not self._passed:
            self._note_first(len(items))
        for part, tag in between_tags(self, items):
            self._record(file, part)
            if tag is None:
                break
            if pmt.eq(tag.key, _RX_TIME):
                if self._timeline.note_tag(self._passed, tag.value):
                    self._begins, self._resumes = True, False
            # Without a sample yet, the carrier that was stated is the mistake.
            elif self._settings.note(tag, takes_carrier=not self._recorded):
                self._begins = self._retuned = True

    def _record(self, file: FileIO, items: Array) -> None:
        """Record items that follow each other, unless they have another rate or carrier."""
        if len(items) and self._settings.usable():
            if self._resumes:
                rule = "started again, and no rx_time reports the samples lost in between"
                raise OSError(errno.ENODATA, rule)
            if self._begins:
                self._begin_capture()
            _write(file, items.view(np.uint8).data)
            self._recorded += len(items)
        self._passed += len(items)

    def _begin_capture(self) -> None:
        capture = {
            "core:sample_start": self._recorded,
            "core:global_index": self._passed + self._timeline.lost,
        }
        if self._retuned:
            capture["wiforce:retuned"] = True
        self._captures.append(capture)
        self._begins = self._retuned = False
        self._write_metadata()

    def _note_first(self, count: int) -> None:
        """Note when the first item was received, the last of ``count`` just now."""
        self._arrived_s = time.time() - count / self._rate
        first = self.get_tags_in_window(0, 0, 1, _RX_TIME)
        device_time = rx_time_value(first[0].value) if first else None
        self._first_s = None if device_time is None else sum(device_time)

    def _utc_s(self) -> float:
        """When the first item was received, as well as that is known."""
        if self._first_s is not None:
            utc_s = self._first_s + self.utc_offset_s
            if abs(utc_s - self._arrived_s) < _UTC_WITHIN_S:
                return utc_s
        return self._arrived_s

    def _write_metadata(self) -> None:
        import json

        utc_s = self._utc_s()
        captures = [
            {
                **capture,
                # Of all: those that differ are left out, and the first may have come before its
                # report.
                "core:frequency": self._settings.carrier(),
                "core:datetime": written_utc(utc_s + capture["core:global_index"] / self._rate),
            }
            for capture in self._captures
        ]
        whole = {"global": self._global, "captures": captures, "annotations": []}
        write_whole(self._meta, json.dumps(whole, indent=2) + "\n")


def _write(file: FileIO, data: memoryview) -> None:
    while data:
        data = data[file.write(data) :]


def _check_new(*paths: Path) -> None:
    for path in paths:
        if path.exists():
            raise InputError(
                path, "exists already, and a recording replaces nothing; choose another name"
            )
        check_output(path)
