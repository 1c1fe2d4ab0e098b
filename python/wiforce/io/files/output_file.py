# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings: created, appended to and completed, also on a disk that is full."""

import errno
import fcntl
import os
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

from ...errors import InputError, OutputError, unwritable
from ..outputs import Output
from ..text.textfile import check_output

_FULL = (errno.ENOSPC, errno.EDQUOT)
# The longest row: what a machine that failed may have left incomplete, and what there must be room
# for before a file is emptied.
LONGEST_ROW = 65_536


class OutputFile:
    """An output without a buffer, locked against other runs while it is a regular file.

    ``kept`` says what remains when it cannot be written further; ``reserve_bytes`` are held on the
    disk so that a file can be ended when it is full (``reserve_used``). Refuses a file that another
    process writes, and to replace one without room for a row.
    """

    def __init__(
        self,
        path: str | Path,
        append: bool = False,
        kept: str = "all rows until then are kept",
        reserve_bytes: int = 0,
        lines: bool = False,
    ) -> None:
        self._path, self._kept, self._lines = path, kept, lines
        self._failure: OutputError | None = None
        self._reserve: IO[bytes] | None = None
        self.size_bytes, self.reserve_used = 0, False
        try:
            self._file = open(path, "ab", buffering=0)
            if Path(path).is_file():
                lock(path, self._file)
                self.size_bytes = os.fstat(self._file.fileno()).st_size
                if not append:
                    self._empty(reserve_bytes)
        except InputError:
            self._file.close()
            raise
        except OSError as error:
            raise unwritable(path, error) from error
        except ValueError as error:
            raise InputError(path, f"cannot be written ({error})") from error

    def _empty(self, reserve_bytes: int) -> None:
        """Empty the file if there is room for a row, and hold space for its end."""
        if self.size_bytes:
            try:
                _reserved(self._path, LONGEST_ROW).close()
            except OSError as error:
                if error.errno in _FULL:
                    raise
            self.cut(0)
        if reserve_bytes:
            with suppress(OSError):
                self._reserve = _reserved(self._path, reserve_bytes)

    @property
    def closed(self) -> bool:
        return self._file.closed

    def tell(self) -> int:
        return self.size_bytes

    def flush(self) -> None:
        """Nothing waits in a buffer."""

    def write(self, data: Any) -> int:
        """Write all of the data, or raise OutputError behind the previous write or whole line."""
        if self._failure is not None:
            raise self._failure
        rest = memoryview(data)
        length = len(rest)
        while len(rest):
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as error:
                if error.errno in _FULL and self._reserve is not None:
                    self._free_reserve()
                    self.reserve_used = True
                    continue
                if self._lines:
                    self.size_bytes += bytes(data).rfind(b"\n", 0, length - len(rest)) + 1
                with suppress(InputError):
                    self.cut(self.size_bytes)
                rule = f"cannot be written further ({error.strerror}); {self._kept}"
                self._failure = OutputError(self._path, rule)
                raise self._failure from error
        self.size_bytes += length
        return length

    def cut(self, size_bytes: int) -> None:
        """Cut off what lies behind so many bytes; InputError where the system refuses that."""
        try:
            self._file.truncate(size_bytes)
        except OSError as error:
            raise InputError(self._path, f"cannot be cut off ({error.strerror})") from error
        self.size_bytes = size_bytes

    def close(self) -> None:
        """Close the file, which then holds what was written."""
        self._free_reserve()
        self._file.close()

    def _free_reserve(self) -> None:
        if self._reserve is not None:
            self._reserve.close()
            self._reserve = None


def lock(path: str | Path, file: IO[Any]) -> bool:
    """Keep other processes from writing a file; False where its file system has no locks."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(path, "is being written to by another process") from None
    except OSError:
        return False
    return True


def _reserved(path: str | Path, size_bytes: int) -> IO[bytes]:
    """A file without a name beside another that holds space, or the OSError that there is none."""
    reserve: IO[bytes] = tempfile.TemporaryFile(dir=Path(path).absolute().parent)
    try:
        os.posix_fallocate(reserve.fileno(), 0, size_bytes)
    except OSError:
        reserve.close()
        raise
    return reserve


# Enough for what waits and the end of an MCAP file of half a day, or a Parquet file of two.
_RESERVE_BYTES = 4_000_000
Ended = TypeVar("Ended", bound="EndedOutput")


class EndedOutput(Output):
    """A file that needs an end, for which space is held on the disk; for several threads.

    The former content is kept until the first row, :meth:`begin` or :meth:`close`. Derived classes
    write their format and its end.
    """

    rows = 0  # taken so far
    _items, _kept = "", ""  # what is kept of a file on a full disk, and of one without its end

    def __init__(self, path: str | Path, inputs: Iterable[str | Path], kind: str) -> None:
        check_output(path, inputs)
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(path, f"{kind} needs a regular file")
        self._path = path
        self._file: OutputFile | None = None
        self._writer: Any = None
        self._failure: OutputError | None = None
        self._lock = threading.RLock()

    def _writer_of(self, file: OutputFile) -> Any:
        raise NotImplementedError

    def _write_end(self) -> None:
        raise NotImplementedError

    def begin(self: Ended) -> Ended:
        """Replace the content of the file, unless done; errors as of :class:`OutputFile`."""
        with self._lock:
            if self._file is None:
                self._file = OutputFile(self._path, kept=self._kept, reserve_bytes=_RESERVE_BYTES)
                self._writer = self._writer_of(self._file)
        return self

    def close(self) -> None:
        self.begin()
        self.abandon()
        if self._failure is not None:
            raise self._failure

    def abandon(self) -> None:
        with self._lock:
            if self._file is None or self._file.closed:
                return
            try:
                if self._writer is not None:  # the disk may have been full from the start
                    self._write_end()
            except OutputError as error:
                self._failure = error
            finally:
                self._file.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Write within this: it raises the OutputError of a former call, and ends a full file."""
        with self._lock:
            if self._failure is not None:
                raise self._failure
            try:
                yield
            except OutputError as error:
                self._failure = error
                raise
            if self._file is not None and self._file.reserve_used:
                kept = f"all {self._items} until then are kept"
                self._failure = OutputError(
                    self._path, f"cannot be written further (disk full); {kept}"
                )
                self.abandon()
                raise self._failure
