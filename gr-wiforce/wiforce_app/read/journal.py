# SPDX-License-Identifier: GPL-3.0-or-later
"""The record of captures that have been read: a line of JSON for each, in ``captures.jsonl``."""

import fcntl
import json
from pathlib import Path

from gnuradio.wiforce.errors import InputError, OutputError

RECORD = "captures.jsonl"


class Journal:
    """Which captures were read into a folder, with which result.

    As a context manager it holds the folder, so that no other run writes to it.

    ``folder``: where the readings are; created if missing.
    """

    def __init__(self, folder):
        self._path = Path(folder) / RECORD
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            # Damaged bytes spoil their own line only.
            self._file = open(self._path, "a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise InputError(folder, f"cannot be used for readings ({error.strerror})") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise InputError(folder, "is being written to by another run") from None
        except OSError:
            pass  # a file system without locks
        self.entries = self._load()

    def __enter__(self):
        return self

    def __exit__(self, *_):
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
            whole = (found.st_size, found.st_mtime_ns) == (
                *(entry.get("size_bytes"), entry.get("time_ns")),
            )
        except OSError:
            return None
        return entry.get("fingerprint") if whole else None

    def note(self, name, **values):
        """Append what became of a capture.

        Raises OutputError on a full disk.
        """
        entry = {"capture": name, **values}
        self._write(json.dumps(entry) + "\n")
        self.entries[name] = entry

    def _write(self, text):
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            raise OutputError(self._path, f"cannot be written ({error.strerror})") from error
