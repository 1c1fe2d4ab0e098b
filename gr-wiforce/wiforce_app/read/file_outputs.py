# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of readings that ``gr-wiforce read`` writes at a time."""

from contextlib import ExitStack
from datetime import datetime, timezone
from pathlib import Path

from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.files.formats import holds_metadata
from gnuradio.wiforce.io.files.writers import open_writer

from ..shell.interrupts import uninterrupted
from ..shell.provenance import provenance


def open_mcap(path, inputs, metadata, sensors):
    """A writer of MCAP; see :class:`McapWriter`.

    ``path``: a file, or a folder for a file named after the time.
    """
    from gnuradio.wiforce.io.files.mcap_file import McapWriter

    if Path(path).is_dir():
        # Names with milliseconds differ, however often a run is started again.
        now = f"{datetime.now(timezone.utc):%Y%m%dT%H%M%S.%f}"[:-3]
        path = Path(path) / f"{now}Z.mcap"
    elif Path(path).suffix.lower() != ".mcap":
        raise InputError("--mcap", "must be FILE.mcap or an existing folder", str(path))
    return McapWriter(path, inputs, metadata, sensors)


class FileOutputs:
    """The readings file of ``gr-wiforce read`` and, optionally, an MCAP file.

    ``output``: as for ``open_writer``; ``inputs``: files that must not be written to. ``rows``:
    readings written so far.
    """

    def __init__(self, output, mcap, inputs, scene):
        described = mcap is not None or holds_metadata(output)
        metadata = provenance(scene) if described else {}
        self._writers = [open_writer(output, inputs, scene.more_columns, metadata=metadata)]
        if mcap is not None:
            self._writers.append(open_mcap(mcap, inputs, metadata, scene.reading_names))
        self._closing = ExitStack()

    def __enter__(self):
        for writer in self._writers:
            self._closing.enter_context(writer)
        return self

    def __exit__(self, *error):
        with uninterrupted():
            return self._closing.__exit__(*error)

    @property
    def rows(self):
        """Readings written so far."""
        return self._writers[0].rows

    def write_all(self, readings):
        """Write readings that came together to all files, also to those behind one that fails.

        An interruption waits until they are in all of them.

        Raises the OutputError of the first file that failed.
        """
        failure = None
        with uninterrupted():
            for writer in self._writers:
                try:
                    writer.write_all(readings)
                except OutputError as error:
                    failure = failure or error
            if failure is not None:
                raise failure
