# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: records samples as SigMF with marked gaps, readable at any time."""

import errno
from datetime import datetime, timezone
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ...errors import InputError
from ...estimation.groups import Array
from ...io.capture.names import recording_stem
from ...io.capture.samples import item_type_named
from ...io.text.textfile import check_output, write_whole
from .. import names
from ..argument_types import typed
from ..kept import Kept
from ..stream_time import Timeline

_RX_TIME = pmt.intern(names.RX_TIME)


class sigmf_recorder(Kept, gr.sync_block):
    """Writes ``PATH.sigmf-data`` and ``PATH.sigmf-meta`` while samples come in.

    Samples are written as they arrive and the metadata is replaced as a whole, so that the
    recording can be read at any time, also after a crash. Where ``rx_time`` reports lost samples, a
    new entry of ``captures`` begins, whose ``core:global_index`` jumps.

    A flowgraph that is started again continues the recording if its first ``rx_time`` reports the
    samples lost in between; otherwise the recording stops.

    A disk error stops the recording, not the flowgraph: see ``failure``.

    Input: samples, complex or complex 16-bit integers.

    Parameters
    ----------
    path : str or Path
        ``.sigmf-data`` or ``.sigmf-meta`` at its end is left out. Nothing is overwritten.
    sample_rate : float
        Samples per second.
    center_frequency : float
        Carrier in Hz.
    item_type : str
        ``fc32`` or ``sc16``.
    fields : dict, optional
        Further entries of the metadata's ``global`` object: ``core:hw``, ``wiforce:scene``, ...

    Attributes
    ----------
    failure : OSError or None
        The error that stopped the recording.

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
        kind = item_type_named(item_type)
        if not sample_rate > 0:
            raise InputError("sample_rate", "must be positive", sample_rate)
        if not center_frequency > 0:
            raise InputError("center_frequency", "must be positive", center_frequency)
        gr.sync_block.__init__(self, "sigmf_recorder", in_sig=[kind.item], out_sig=None)
        self.failure: OSError | None = None
        self._center_frequency = center_frequency
        self._timeline = Timeline(sample_rate)
        self._captures: list[dict[str, Any]] = []
        self._recorded = 0
        self._global = {
            "core:datatype": kind.datatype,
            "core:sample_rate": sample_rate,
            "core:version": "1.0.0",
            "core:num_channels": 1,
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
        try:
            self._file = open(self._data, "xb" if self._file is None else "ab", buffering=0)
        except OSError as error:
            self._stop_recording(error)
        return True

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        items = input_items[0]
        if self.failure is None and self._file is not None:
            try:
                self._note(len(items))
                _write(self._file, np.ascontiguousarray(items).view(np.uint8).data)
                self._recorded += len(items)
            except OSError as error:
                self._stop_recording(error)
        return len(items)

    def stop(self) -> bool:
        if self._file is not None:
            self._file.close()
        return True

    def _stop_recording(self, error: OSError) -> None:
        self.failure = error
        gr.log.error(f"sigmf_recorder: {self._data}: {error.strerror}; recording stopped")

    def _note(self, count: int) -> None:
        """A new entry of the metadata for the first item, and for each after lost samples."""
        begins = [] if self._captures else [(0, 0)]
        # GNU Radio counts items from 0 whenever a flowgraph starts.
        before = self._recorded - self.nitems_read(0)
        resumes = before == self._recorded > 0
        for tag in self.get_tags_in_window(0, 0, count, _RX_TIME):
            if self._timeline.note(before + tag.offset, tag.value):
                begins.append((before + tag.offset, self._timeline.lost))
        if resumes and self._recorded not in (item for item, _ in begins):
            rule = "started again, and no rx_time reports the samples lost in between"
            raise OSError(errno.ENODATA, rule)
        for item, lost in begins:
            self._captures.append(
                {
                    "core:sample_start": item,
                    "core:global_index": item + lost,
                    "core:frequency": self._center_frequency,
                    "core:datetime": datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
                }
            )
        if begins:
            self._write_metadata()

    def _write_metadata(self) -> None:
        import json

        whole = {"global": self._global, "captures": self._captures, "annotations": []}
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
