# SPDX-License-Identifier: GPL-3.0-or-later
"""One of many captures, read by a process of its own."""

import contextlib
import io
import os
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.readings import GroupCounts
from gnuradio.wiforce.io.writers import open_writer
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import scene_of

from ..file_outputs import provenance
from ..marks import mark_of


@dataclass(frozen=True)
class ReadingJob:
    """A capture to be read into a file.

    Attributes
    ----------
    name, path : str
        Of the capture: what its readings are called, and its absolute path.
    output : str
        Absolute path of its readings.
    scene : str or None
        Scene file or name of a shipped scene; None for the capture's own.
    settings : dict
        ``datatype``, ``frame_offset`` and ``tracked``.
    mark : str or None
        Of the readings that exist already.
    """

    name: str
    path: str
    output: str
    scene: str | None
    settings: dict
    mark: str | None = None


@dataclass(frozen=True)
class ReadingReport:
    """What became of a capture.

    Attributes
    ----------
    mark : str
        Hash of all that its readings depend on.
    unchanged : bool
        It was not read, since readings with this mark exist.
    rows : int
    counts : GroupCounts
    messages : list of str
        Warnings, without the program's name.
    """

    mark: str
    unchanged: bool
    rows: int = 0
    counts: GroupCounts = field(default_factory=GroupCounts)
    messages: list = field(default_factory=list)


def read_capture_file(job):
    """Read a capture into its file, which appears when it is complete.

    Parameters
    ----------
    job : ReadingJob

    Returns
    -------
    ReadingReport

    Raises
    ------
    InputError, OutputError
        As ``gr-wiforce read`` for this capture.
    """
    messages = io.StringIO()
    with contextlib.redirect_stderr(messages):
        report = _read(job)
    program = "gr-wiforce: "
    lines = [line.removeprefix(program) for line in messages.getvalue().splitlines()]
    report.messages.extend(lines)
    return report


def _read(job):
    from ..read import open_reader, warn_of_end, warn_of_start

    recording = open_capture(job.path, job.settings["datatype"])
    scene, differences = scene_of(recording, job.scene)
    mark = mark_of(scene, job.settings, *map(_identity, recording.files))
    if mark == job.mark:
        return ReadingReport(mark, unchanged=True)
    frame_offset = job.settings["frame_offset"]
    reader = open_reader(recording, plan(scene), frame_offset, job.settings["tracked"])
    warn_of_start(recording, reader, differences, frame_offset)
    output = Path(job.output)
    output.parent.mkdir(parents=True, exist_ok=True)
    # Another worker may read the same capture, if this one is taken for lost.
    partial = output.with_name(f".{output.stem}.{uuid.uuid4().hex}{output.suffix}")
    try:
        metadata = provenance(scene) if output.suffix == ".parquet" else {}
        inputs = [*recording.files, *scene.files]
        with open_writer(partial, inputs, metadata=metadata) as writer:
            for batch in reader:
                for reading in batch:
                    writer.write(reading)
        os.replace(partial, output)
    finally:
        partial.unlink(missing_ok=True)
    warn_of_end(job.path, reader)
    return ReadingReport(mark, False, writer.rows, reader.counts)


def _identity(file):
    """What changes when a file does; reading it for a hash would take as long as its readings."""
    state = file.stat()
    return [file.name, state.st_size, state.st_mtime_ns]
