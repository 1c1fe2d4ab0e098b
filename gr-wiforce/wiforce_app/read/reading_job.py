# SPDX-License-Identifier: GPL-3.0-or-later
"""One of many captures, read by a process of its own."""

import contextlib
import hashlib
import io
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.readings import GroupCounts

from ..shell.log import PROGRAM

_UUID_DIGITS = len(uuid.uuid4().hex)
# Longer than most metadata, and thousands of noisy samples.
_PROBE_BYTES = 65536


@dataclass(frozen=True)
class ReadingJob:
    """A capture to be read into a file.

    ``name``, ``path``: of the capture: what its readings are called, and its absolute path;
    ``output``: absolute path of its readings; ``scene``: scene file or name of a shipped scene;
    None for the capture's own; ``settings``: ``datatype``, ``frame_offset`` and ``tracked``;
    ``fingerprint``: of the readings that exist already.
    """

    name: str
    path: str
    output: str
    scene: str | None
    settings: dict
    fingerprint: str | None = None


@dataclass(frozen=True)
class ReadingReport:
    """What became of a capture.

    ``fingerprint``: hash of all that its readings depend on; ``unchanged``: it was not read, since
    readings with this fingerprint exist; ``messages``: warnings, without the program's name;
    ``partial``: where the readings are, until whoever asked for them renames them to the job's
    output.
    """

    fingerprint: str
    unchanged: bool
    rows: int = 0
    counts: GroupCounts = field(default_factory=GroupCounts)
    messages: list = field(default_factory=list)
    partial: str | None = None


def read_capture_file(job):
    """Read a capture into a file of its own beside the job's output.

    The output itself is not replaced here: a worker may outlive the run that started it, and would
    then put its readings in the place of those of a later run.
    """
    messages = io.StringIO()
    with contextlib.redirect_stderr(messages):
        report = _read(job)
    lines = [line.removeprefix(f"{PROGRAM}: ") for line in messages.getvalue().splitlines()]
    report.messages.extend(lines)
    return report


def _read(job):
    # In the process of a worker alone: the command, which sends jobs to it, starts faster without.
    from gnuradio.wiforce.io.files.writers import open_writer
    from gnuradio.wiforce.planning.plan import plan
    from gnuradio.wiforce.scene import scene_of

    from ..shell.provenance import fingerprint, provenance
    from .recordings import open_reader, open_recording, warn, warn_of_end, warn_of_start

    recording = open_recording(job.path, job.settings["datatype"])
    scene, differences = scene_of(recording, job.scene)
    identities = [_identity(file) for file in recording.files]
    current = fingerprint(scene, job.settings, *identities)
    if current == job.fingerprint:
        return ReadingReport(current, unchanged=True)
    frame_offset = job.settings["frame_offset"]
    reader = open_reader(recording, plan(scene), frame_offset, job.settings["tracked"])
    warn_of_start(recording, reader, scene, differences, frame_offset)
    output = Path(job.output)
    output.parent.mkdir(parents=True, exist_ok=True)
    # Another worker may read the same capture, if this one is taken for lost.
    partial = output.with_name(f".{output.stem}.{uuid.uuid4().hex}{output.suffix}")
    complete = False
    try:
        metadata = provenance(scene) if output.suffix == ".parquet" else {}
        inputs = [*recording.files, *scene.files]
        with open_writer(partial, inputs, scene.more_columns, metadata=metadata) as writer:
            for batch in reader:
                for reading in batch:
                    writer.write(reading)
        complete = True
    except OutputError as error:
        # The file that it names, and what it says of its rows, is about to go.
        raise OutputError(output, f"cannot be written ({error.reason})") from None
    finally:
        if not complete:
            partial.unlink(missing_ok=True)
    warn_of_end(job.path, reader)
    if [_identity(file) for file in recording.files] != identities:
        warn(job.path, "changed while it was read; repeat the command when it is complete")
    return ReadingReport(current, False, writer.rows, reader.counts, partial=str(partial))


def remove_partial(outputs):
    """Remove what workers of former runs have left beside the outputs of this one."""
    wanted = {(output.parent, output.stem, output.suffix) for output in outputs}
    for folder in {folder for folder, _, _ in wanted}:
        for file in folder.glob(".*.*.*") if folder.is_dir() else ():
            stem, _, identifier = file.stem[1:].rpartition(".")
            if len(identifier) == _UUID_DIGITS and (folder, stem, file.suffix) in wanted:
                file.unlink(missing_ok=True)


def _identity(file):
    """What changes when a file does; reading all of it would take as long as its readings.

    Recordings of equal length that were copied together may agree in size and time, so their
    noise is compared in three places.
    """
    state = file.stat()
    found = hashlib.sha256()
    with open(file, "rb") as opened:
        for start in (0, state.st_size // 2, max(state.st_size - _PROBE_BYTES, 0)):
            opened.seek(start)
            found.update(opened.read(_PROBE_BYTES))
    return [file.name, state.st_size, state.st_mtime_ns, found.hexdigest()]
