# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: a capture's samples while they are still being written."""

import os
import threading
import time
from pathlib import Path

import numpy as np
import pmt
from gnuradio import gr

from ...errors import InputError
from ...estimation.groups import Array
from ...io.capture.recordings import Capture, open_capture
from ...io.capture.samples import DATATYPES
from .. import names
from ..argument_types import typed
from ..kept import Kept
from ..stream_time import time_value

# Interval at which the file is checked for new samples.
_POLL_S = 0.1


class capture_stream(Kept, gr.sync_block):
    """Samples of a growing capture, with ``rx_time`` at its start and after every gap.

    A gap must be in the metadata before the samples after it are in the data, as
    ``sigmf_recorder`` writes them. A gap that is reported later ends the stream with an error,
    since samples have been sent with a wrong time; so does another sample rate or carrier.

    Parameters
    ----------
    path : str or Path
        SigMF pair, by either file's name or their common stem; raw samples with ``datatype``.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.
    sample_rate : float
        Samples per second.

    Attributes
    ----------
    item_type : str
        ``sc16`` or ``fc32``.
    ended : threading.Event
        When set, the stream ends with what is in the file.
    failure : Exception or None
        The error that ended the stream.

    Examples
    --------
    >>> stream = capture_stream("press", sample_rate=12.5e6)  # doctest: +SKIP
    >>> stream.ended.set()  # doctest: +SKIP
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
        return True

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
        self.add_item_tag(0, self.nitems_written(0), pmt.intern(names.RX_TIME), value)

    def _read(self, out: Array) -> int:
        place = self._at * self._sample_bytes
        read = os.preadv(self._file.fileno(), [out.view(np.uint8).data], place)
        if read < out.nbytes:
            raise InputError(self._known.path, "was cut short while it was read")
        return len(out)
