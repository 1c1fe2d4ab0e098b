# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of many captures: which are there and whole, and one table of all."""

import fcntl
import json
from pathlib import Path

from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.io.text.textfile import check_output, replacing

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


CAPTURE = "capture"
_METADATA = b"wiforce:captures"


def check_whole(path):
    """Refuse a path that cannot be written to, and a missing pyarrow, before captures are read."""
    optional_module("pyarrow", "--output")
    check_output(path)


def join_parts(path, parts):
    """Write one file from those of the captures; it appears when it is complete.

    Returns int: number of readings. The file's metadata hold those of each capture under
    ``wiforce:captures``, as JSON.

    ``parts``: name of a capture and the Parquet file of its readings.
    """
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
