# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce read`` of many captures: in parallel, each once, with a summary at the end."""

import contextlib
import hashlib
import io
import json
import os
import shutil
import tempfile
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.capture.names import find_captures
from gnuradio.wiforce.io.files import format_of
from gnuradio.wiforce.io.files.output_file import lock
from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.io.readings import GroupCounts
from gnuradio.wiforce.io.text.textfile import check_output, replacing

from ..shell.interrupts import BAD_INPUT, FAILED, Interrupted
from ..shell.log import PROGRAM, log, progress
from ..shell.workers import WorkerLost, run_tasks

_RECORD = "captures.jsonl"  # of what was read into a folder
_PARTIAL = ".gr-wiforce-partial-"
# Longer than most metadata, and thousands of noisy samples.
_PROBE_BYTES = 65536
# Column and metadata of one file of all readings.
_CAPTURE, _METADATA = "capture", b"wiforce:captures"


def read_many(given, scene, output, form, again, jobs, settings):
    """Read captures, patterns and folders into a folder or one Parquet file; exit status."""
    if scene is not None:
        from gnuradio.wiforce.scene import load_scene

        load_scene(scene)
    captures = find_captures(given, settings["datatype"])
    folder, suffix, whole = _destination(output, form)
    for capture in captures:
        if f"{capture.name}.{suffix}" == _RECORD:
            raise InputError(capture.path, f"readings cannot be called {_RECORD}; use --format csv")
    with Journal(folder) as journal:
        tasks = []
        for capture in captures:
            path = (folder / f"{capture.name}.{suffix}").absolute()
            known = None if again else journal.fingerprint(capture.name, path)
            read = os.path.abspath(capture.path), str(path), journal.partial
            tasks.append(ReadingJob(capture.name, *read, scene, settings, known))
        _protect_captures(tasks, whole)
        reports, failures = [], {}
        try:
            _run(tasks, jobs, journal, reports, failures)
        except KeyboardInterrupt as interrupt:
            text = f"{len(reports)} of {len(tasks)} captures have been read; the same command "
            raise Interrupted(f"{text}reads the others") from interrupt
        finally:
            for name, error in sorted(failures.items()):
                log.error(f"error: {name}: {_text_of(error)}")
        if whole is not None:
            names = [task.name for task in tasks if task.name not in failures]
            if names:
                rows = _join_parts(whole, [(name, folder / f"{name}.parquet") for name in names])
                kept = f"{folder} is for a repeated run, and may be deleted"
                log.info(f"wrote {rows} readings to {whole}; {kept}")
            else:
                log.info(f"{whole} was not written, since no capture could be read")
    log.info(_summary(reports, len(failures)))
    if not failures:
        return 0
    own_fault = all(isinstance(error, InputError) for error in failures.values())
    return BAD_INPUT if own_fault else FAILED


def _protect_captures(tasks, whole):
    """Refuse outputs that are captures: raw samples may have any name."""
    captures = [Path(task.path) for task in tasks if os.path.isfile(task.path)]
    if captures:
        known = {(state.st_dev, state.st_ino) for state in map(os.stat, captures)}
        for output in [*(task.output for task in tasks), *([whole] if whole else [])]:
            with contextlib.suppress(OSError):
                state = os.stat(output)
                if (state.st_dev, state.st_ino) in known:
                    raise InputError(output, "cannot be written (is one of the captures)")


def _run(tasks, jobs, journal, reports, failures):
    """Add the report of each capture to ``reports``, or its error by name to ``failures``."""
    with progress(f"reading {len(tasks)} captures", len(tasks)) as step:
        # Closed at once when interrupted, so that no worker goes on.
        with contextlib.closing(run_tasks(read_capture_file, tasks, jobs)) as found:
            for outcome in found:
                task = tasks[outcome.index]
                if outcome.error is not None:
                    journal.note(task.name, error=str(outcome.error))
                    failures[task.name] = outcome.error
                else:
                    _keep(journal, task, outcome.result)
                    reports.append(outcome.result)
                    for message in outcome.result.messages:
                        log.info(message if task.path in message else f"{task.name}: {message}")
                step(1)


def _keep(journal, task, report):
    if report.unchanged:
        return
    output = Path(task.output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        os.replace(report.partial, output)
        written = output.stat()
    except OSError as error:
        raise OutputError(output, f"cannot be written ({error.strerror})") from error
    journal.note(
        task.name,
        fingerprint=report.fingerprint,
        output=output.name,
        size_bytes=written.st_size,
        time_ns=written.st_mtime_ns,
        rows=report.rows,
        **report.counts.asdict(),
        messages=report.messages,
    )


def _summary(reports, failed):
    """Counts of captures by outcome, and of their groups, in one line."""
    unchanged, counts = sum(report.unchanged for report in reports), GroupCounts()
    for report in reports:
        counts.add(report.counts)
    read = len(reports) - unchanged
    text = f"{read} of {len(reports) + failed} captures read"
    text += f", {unchanged} had been read before" * (unchanged > 0)
    text += f", {failed} failed" * (failed > 0)
    return f"{text}; {counts}" if read else text


def _text_of(error):
    if isinstance(error, InputError | OutputError | WorkerLost):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return f"{type(error).__name__}: {error}"


def _destination(output, form):
    """Folder and suffix of the readings, and the one Parquet file that holds all, or None."""
    if output is None:
        rule = "is needed for several captures or a folder of them: a folder, or OUT.parquet"
        raise InputError("--output", rule)
    path = Path(output)
    if output.lower().endswith(".parquet"):
        if form not in (None, "parquet"):
            raise InputError("--format", "must be parquet for a file that ends in .parquet", form)
        optional_module("pyarrow", "--output")
        check_output(path)
        return path.with_name(f"{path.name}.parts"), "parquet", path
    if format_of(path) or path.suffix.lower() == ".json" or path.is_file():
        rule = "must be a folder, or a file that ends in .parquet, for several captures"
        raise InputError("--output", rule, output)
    return path, form or "csv", None


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
    try:
        inputs = [*recording.files, *scene.files]
        metadata = provenance(scene)
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


class Journal:
    """Which captures were read into a folder with which result; holds it against other runs.

    ``partial`` is a folder in it for what is not complete.
    """

    def __init__(self, folder):
        folder = Path(folder).absolute()
        self._path = folder / _RECORD
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Damaged bytes spoil their own line only.
            self._file = open(self._path, "a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise InputError(folder, f"cannot be used for readings ({error.strerror})") from error
        try:
            if lock(folder, self._file):
                for left in folder.glob(f"{_PARTIAL}*"):
                    shutil.rmtree(left, ignore_errors=True)
        except InputError:
            self._file.close()
            raise
        self.entries = self._load()
        self.partial = tempfile.mkdtemp(prefix=_PARTIAL, dir=folder)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        shutil.rmtree(self.partial, ignore_errors=True)
        # What a full disk did not take is in the buffer, and was reported with the file's name.
        with contextlib.suppress(OSError):
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


def _join_parts(path, parts):
    """Write one file, complete, of captures' names and Parquet files; number of readings."""
    import pyarrow
    from gnuradio.wiforce.io.files.readings_files import ReadingsFile
    from pyarrow import parquet

    rows, described = 0, {}
    # A capture of a surface has more columns than one without.
    schemas = [parquet.read_schema(part).remove_metadata() for _, part in parts]
    plain = pyarrow.unify_schemas(schemas)
    field = pyarrow.field(_CAPTURE, pyarrow.dictionary(pyarrow.int32(), pyarrow.utf8()))
    options = {"compression": "zstd", "write_page_checksum": True}
    with (
        replacing(path) as partial,
        parquet.ParquetWriter(partial, plain.insert(0, field), **options) as writer,
    ):
        for name, part in parts:
            table = parquet.read_table(part, page_checksum_verification=True)
            described[name] = ReadingsFile(part).metadata
            table = pyarrow.concat_tables([plain.empty_table(), table], promote_options="default")
            names = pyarrow.array([name] * len(table)).cast(field.type)
            writer.write_table(table.add_column(0, field, names).replace_schema_metadata())
            rows += len(table)
        writer.add_key_value_metadata({_METADATA.decode(): json.dumps(described)})
    return rows
