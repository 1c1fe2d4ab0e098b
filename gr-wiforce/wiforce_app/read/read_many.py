# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce read`` of many captures: in parallel, each once, with a summary at the end."""

import contextlib
import errno
import os
import shutil
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.capture.names import find_captures
from gnuradio.wiforce.io.files.formats import format_of
from gnuradio.wiforce.io.readings import GroupCounts
from gnuradio.wiforce.io.text.textfile import replacing

from ..shell.interrupts import BAD_INPUT, FAILED, Interrupted
from ..shell.log import PROGRAM, printable, progress
from ..shell.workers import WorkerLost, run_tasks
from .reading_job import RECORD, Journal, ReadingJob, read_capture_file


def read_many(given, scene, output, form, again, jobs, settings):
    """Read captures, patterns and folders into a folder or one Parquet file; exit status."""
    if scene is not None:
        from gnuradio.wiforce.scene import load_scene

        load_scene(scene)
    captures = find_captures(given, settings["datatype"])
    whole = _whole_file(output, form)
    folder = _folder_of(output) if whole is None else whole.with_name(f"{whole.name}.parts")
    if whole is not None:
        from .reading_job import check_whole, join_parts

        check_whole(whole)
    suffix = "parquet" if whole is not None else form or "csv"
    for capture in captures:
        if f"{capture.name}.{suffix}" == RECORD:
            raise InputError(capture.path, f"readings cannot be called {RECORD}; use --format csv")
    with Journal(folder) as journal:
        tasks = []
        for capture in captures:
            path = (folder / f"{capture.name}.{suffix}").absolute()
            known = None if again else journal.fingerprint(capture.name, path)
            read = os.path.abspath(capture.path), str(path), journal.partial
            tasks.append(ReadingJob(capture.name, *read, scene, settings, known))
        _protect_captures(tasks, whole)
        summary = _Summary(len(tasks))
        try:
            _run(tasks, jobs, journal, summary)
        except KeyboardInterrupt as interrupt:
            text = f"{summary.done} of {len(tasks)} captures have been read; the same command "
            raise Interrupted(f"{text}reads the others") from interrupt
        finally:
            summary.list_failures()
        if whole is not None:
            names = [task.name for task in tasks if task.name not in summary.failures]
            if names:
                rows = join_parts(whole, [(name, folder / f"{name}.parquet") for name in names])
                kept = f"{folder} is for a repeated run, and may be deleted"
                _say(f"wrote {rows} readings to {whole}; {kept}")
            else:
                _say(f"{whole} was not written, since no capture could be read")
    _say(str(summary))
    return summary.status


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


def _say(text):
    click.echo(f"{PROGRAM}: {printable(text)}", err=True)


def _run(tasks, jobs, journal, summary):
    sizes = [_size(task) for task in tasks]
    with progress(f"reading {len(tasks)} captures", sum(sizes)) as step:
        # Closed at once when interrupted, so that no worker goes on.
        with contextlib.closing(run_tasks(read_capture_file, tasks, jobs)) as outcomes:
            for outcome in outcomes:
                task = tasks[outcome.index]
                if outcome.error is None:
                    _keep(journal, task, outcome.result)
                else:
                    journal.note(task.name, error=str(outcome.error))
                summary.note(task, outcome)
                step(sizes[outcome.index])


def _keep(journal, task, report):
    if report.unchanged:
        return
    output = Path(task.output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.replace(report.partial, output)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            with replacing(output) as beside:  # the output's folder is on another disk
                shutil.copyfile(report.partial, beside)
            os.unlink(report.partial)
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


class _Summary:
    """What became of the captures."""

    def __init__(self, captures):
        self._captures = captures
        self._counts = GroupCounts()
        self._unchanged = 0
        self.done = 0
        self.failures = {}

    def note(self, task, outcome):
        """Count a capture, and print its warnings."""
        if outcome.error is not None:
            self.failures[task.name] = outcome.error
            return
        self.done += 1
        self._unchanged += outcome.result.unchanged
        self._counts.add(outcome.result.counts)
        for message in outcome.result.messages:
            named = message if task.path in message else f"{task.name}: {message}"
            _say(named)

    def list_failures(self):
        """Print each capture that could not be read, and why."""
        for name, error in sorted(self.failures.items()):
            _say(f"error: {name}: {_text_of(error)}")

    @property
    def status(self):
        """Exit status."""
        if not self.failures:
            return 0
        own_fault = all(isinstance(error, InputError) for error in self.failures.values())
        return BAD_INPUT if own_fault else FAILED

    def __str__(self):
        read = self.done - self._unchanged
        parts = [f"{read} of {self._captures} captures read"]
        if self._unchanged:
            parts.append(f"{self._unchanged} had been read before")
        if self.failures:
            parts.append(f"{len(self.failures)} failed")
        text = ", ".join(parts)
        return f"{text}; {self._counts}" if read else text


def _text_of(error):
    if isinstance(error, InputError | OutputError | WorkerLost):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return f"{type(error).__name__}: {error}"


def _whole_file(output, form):
    """The one Parquet file to write, None for a folder of files."""
    if output is None:
        rule = "is needed for several captures: a folder, or a file that ends in .parquet"
        raise InputError("--output", rule)
    if not output.lower().endswith(".parquet"):
        return None
    if form not in (None, "parquet"):
        raise InputError("--format", "must be parquet for a file that ends in .parquet", form)
    return Path(output)


def _folder_of(output):
    folder = Path(output)
    if format_of(folder) or folder.suffix.lower() == ".json" or folder.is_file():
        rule = "must be a folder, or a file that ends in .parquet, for several captures"
        raise InputError("--output", rule, output)
    return folder


def _size(task):
    """Size of the samples, which the time to read them is proportional to."""
    for path in (f"{task.path}.sigmf-data", task.path):
        with contextlib.suppress(OSError):
            return os.stat(path).st_size
    return 0
