# SPDX-License-Identifier: GPL-3.0-or-later
"""One capture of many: how it is read, which readings are kept, and one table of all."""

import contextlib
import fcntl
import hashlib
import io
import json
import shutil
import tempfile
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.io.readings import GroupCounts
from gnuradio.wiforce.io.text.textfile import check_output, replacing

from ..shell.log import PROGRAM

# Longer than most metadata, and thousands of noisy samples.
_PROBE_BYTES = 65536


@dataclass(frozen=True)
class ReadingJob:
    """A capture to be read into a file."""

    name: str  # what its readings are called
    path: str  # absolute, as that of its readings
    output: str
    partial: str  # folder for what is not complete
    scene: str | None  # file or name of a shipped scene; None for the capture's own
    settings: dict  # datatype, frame_offset and tracked
    fingerprint: str | None = None  # of the readings that exist already


@dataclass(frozen=True)
class ReadingReport:
    """What became of a capture."""

    fingerprint: str  # hash of all that its readings depend on
    unchanged: bool  # it was not read, since readings with this fingerprint exist
    rows: int = 0
    counts: GroupCounts = field(default_factory=GroupCounts)
    messages: list = field(default_factory=list)  # warnings, without the program's name
    partial: str | None = None  # where the readings are, until the run renames them


def read_capture_file(job):
    """Read a capture into a partial file: a late worker must not replace the output."""
    messages = io.StringIO()
    with contextlib.redirect_stderr(messages):
        report = _read(job)
    lines = [line.removeprefix(f"{PROGRAM}: ") for line in messages.getvalue().splitlines()]
    report.messages.extend(lines)
    return report


def _read(job):
    # In the process of a worker alone: the command, which sends jobs to it, starts faster without.
    from gnuradio.wiforce.io.files.formats import holds_metadata
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
    # Another worker may read the same capture, if this one is taken for lost.
    partial = Path(job.partial) / f"{uuid.uuid4().hex}{Path(job.output).suffix}"
    metadata = provenance(scene) if holds_metadata(partial) else {}
    try:
        inputs = [*recording.files, *scene.files]
        with open_writer(partial, inputs, scene.more_columns, metadata=metadata) as writer:
            for batch in reader:
                writer.write_all(batch)
    except OutputError as error:
        # The file that it names, and what it says of its rows, is about to go.
        raise OutputError(job.output, f"cannot be written ({error.reason})") from None
    warn_of_end(job.path, reader)
    if [_identity(file) for file in recording.files] != identities:
        warn(job.path, "changed while it was read; repeat the command when it is complete")
    return ReadingReport(current, False, writer.rows, reader.counts, partial=str(partial))


def _identity(file):
    """What changes when a file does: its size, time, and noise in three places."""
    state = file.stat()
    found = hashlib.sha256()
    with open(file, "rb") as opened:
        for start in (0, state.st_size // 2, max(state.st_size - _PROBE_BYTES, 0)):
            opened.seek(start)
            found.update(opened.read(_PROBE_BYTES))
    return [file.name, state.st_size, state.st_mtime_ns, found.hexdigest()]


RECORD = "captures.jsonl"
_PARTIAL = ".gr-wiforce-partial-"


class Journal:
    """Which captures were read into a folder with which result; holds it against other runs.

    ``partial`` is a folder in it for what is not complete.
    """

    def __init__(self, folder):
        folder = Path(folder).absolute()
        self._path = folder / RECORD
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Damaged bytes spoil their own line only.
            self._file = open(self._path, "a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise InputError(folder, f"cannot be used for readings ({error.strerror})") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for left in folder.glob(f"{_PARTIAL}*"):
                shutil.rmtree(left, ignore_errors=True)
        except BlockingIOError:
            self._file.close()
            raise InputError(folder, "is being written to by another run") from None
        except OSError:
            pass  # a file system without locks
        self.entries = self._load()
        self.partial = tempfile.mkdtemp(prefix=_PARTIAL, dir=folder)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        shutil.rmtree(self.partial, ignore_errors=True)
        self._file.close()

    def _load(self):
        self._file.seek(0)
        entries, line = {}, "\n"
        for line in self._file:
            try:
                entry = json.loads(line)
                entries[entry["capture"]] = entry
            except (ValueError, TypeError, KeyError, RecursionError):
                continue  # cut off by a power failure, or not ours
        if not line.endswith("\n"):
            self._write("\n")  # or the next entry would be lost with this one
        return entries

    def fingerprint(self, name, output):
        """The fingerprint of a capture's readings, None unless they are there and whole."""
        entry = self.entries.get(name, {})
        try:
            found = output.stat()
        except OSError:
            return None
        stated = entry.get("size_bytes"), entry.get("time_ns")
        return entry.get("fingerprint") if stated == (found.st_size, found.st_mtime_ns) else None

    def note(self, name, **values):
        """Append what became of a capture; raises OutputError on a full disk."""
        entry = {"capture": name, **values}
        self._write(json.dumps(entry) + "\n")
        self.entries[name] = entry

    def _write(self, text):
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            raise OutputError(self._path, f"cannot be written ({error.strerror})") from error


CAPTURE = "capture"
_METADATA = b"wiforce:captures"


def check_whole(path):
    """Refuse a path that cannot be written to, and a missing pyarrow, before captures are read."""
    optional_module("pyarrow", "--output")
    check_output(path)


def join_parts(path, parts):
    """Write one file, complete, of captures' names and Parquet files; number of readings."""
    import pyarrow
    from pyarrow import parquet

    rows, described = 0, {}
    # A capture of a surface has more columns than one without.
    schemas = [parquet.read_schema(part).remove_metadata() for _, part in parts]
    plain = pyarrow.unify_schemas(schemas) if schemas else None
    with replacing(path) as partial:
        writer = None
        for name, part in parts:
            with parquet.ParquetFile(part, page_checksum_verification=True) as file:
                described[name] = _own_metadata(file.schema_arrow)
                field = pyarrow.field(CAPTURE, pyarrow.dictionary(pyarrow.int32(), pyarrow.utf8()))
                if writer is None:
                    schema = plain.insert(0, field)
                    writer = parquet.ParquetWriter(
                        partial, schema, compression="zstd", write_page_checksum=True
                    )
                for batch in file.iter_batches():
                    names = pyarrow.array([name] * len(batch)).cast(field.type)
                    held = dict(zip(batch.schema.names, batch.columns, strict=True))
                    nothing = [None] * len(batch)
                    own = [held.get(f.name, pyarrow.array(nothing, f.type)) for f in plain]
                    columns = [names, *own]
                    writer.write_batch(pyarrow.record_batch(columns, schema=schema))
                    rows += len(batch)
        if writer is not None:
            writer.add_key_value_metadata({_METADATA.decode(): json.dumps(described)})
            writer.close()
    return rows


def _own_metadata(schema):
    """What a capture's file says of its scene, sensors and version."""
    found = schema.metadata or {}
    return {
        key.decode(): value.decode() for key, value in found.items() if key.startswith(b"wiforce:")
    }
