# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the forces of a guided calibration come from: a CSV stream or a serial gauge."""

import csv
import os
import stat
import time

from gnuradio.wiforce.calibration.gauges import ForceGauge, parse_force, unit_n
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.optional import optional_module

_CHUNK_BYTES = 65536
_SERIAL = "serial:"


def open_scale(text, unit, baud):
    """Open ``serial:DEVICE`` of a rate, or a CSV file or pipe; ``unit``: of lines without one."""
    unit_n(unit, "--scale-unit")
    if text.startswith(_SERIAL):
        return SerialScale(text.removeprefix(_SERIAL), unit, baud)
    return CsvScale(text)


class _LineScale:
    """Splits what arrives into lines."""

    def __init__(self, name, unit="N"):
        self.gauge = ForceGauge(name, unit, time.monotonic())
        self._rest = b""

    def poll(self):
        """Take what has arrived."""
        *lines, self._rest = (self._rest + self._read()).replace(b"\r", b"\n").split(b"\n")
        self._rest = self._rest[-_CHUNK_BYTES:]
        for line in lines:
            if line.strip():
                self._take(line.decode("utf-8", "replace"))

    def _take(self, line):
        self.gauge.note(time.monotonic(), line)


class CsvScale(_LineScale):
    """A CSV stream with ``force_n``: a pipe, or a growing file, whose old rows are ignored."""

    def __init__(self, path):
        super().__init__(str(path))
        self._path, self._column = path, None
        try:
            # A pipe would otherwise wait for its writer.
            self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(path, f"cannot be read ({reason})") from error
        self._skip = stat.S_ISREG(os.fstat(self._descriptor).st_mode)

    def close(self):
        os.close(self._descriptor)

    def _read(self):
        try:
            data = os.read(self._descriptor, _CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror})") from error
        if self._column is not None or b"\n" not in data:
            return data
        header, data = data.split(b"\n", 1)
        self._read_header((self._rest + header).decode("utf-8", "replace"))
        self._rest = b""
        if self._skip:
            os.lseek(self._descriptor, 0, os.SEEK_END)
            return b""
        return data

    def _read_header(self, line):
        names = [name.strip() for name in next(csv.reader([line.lstrip("\ufeff")]), [])]
        if "force_n" not in names:
            raise InputError(self._path, "must have a header with a column force_n", line.strip())
        self._column = names.index("force_n")

    def _take(self, line):
        cells = next(csv.reader([line]), [])
        try:
            force_n = parse_force(cells[self._column])
        except (IndexError, InputError):
            return
        self.gauge.note_force(time.monotonic(), force_n)


class SerialScale(_LineScale):
    """A gauge or scale at a serial port, which sends a line of text per value."""

    def __init__(self, device, unit, baud):
        super().__init__(device, unit)
        serial = optional_module("serial", "--scale")
        self._failure = (OSError, serial.SerialException)
        try:
            # A URL such as socket://HOST:PORT as well.
            self._port = serial.serial_for_url(device, baudrate=baud, timeout=0)
        except (OSError, ValueError) as error:
            reason = os.strerror(error.errno) if getattr(error, "errno", None) else error
            raise InputError("--scale", f"must name a serial port ({reason})", device) from error

    def close(self):
        self._port.close()

    def _read(self):
        try:
            return self._port.read(_CHUNK_BYTES)
        except self._failure as error:
            raise InputError(self.gauge.name, f"cannot be read any more ({error})") from error
