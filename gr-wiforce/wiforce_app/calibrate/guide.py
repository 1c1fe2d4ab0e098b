# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided calibration of ``calibrate --live``: the person, the reader, the scale and the options."""

import csv
import math
import os
import select
import stat
import time
from collections import deque
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import click
from gnuradio.wiforce.calibration.gauges import ForceGauge, parse_force, unit_n
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.press.sensor_readout import uncalibrated_readings

# Length of a measurement: a person can hold a press still for half a second.
_MEASURE_S = 0.5
_LOOK_S = 0.02
# Without readings for this long, in wall time, something is wrong.
_PATIENCE_S, _START_PATIENCE_S = 5.0, 60.0
_KEPT = 4096


class LivePresses:
    """Collects readings of one sensor, made without its model; ``idle`` while waiting."""

    def __init__(self, session, keeper, sensor, scene):
        from gnuradio.wiforce.calibration.session import LEAST_GROUPS

        self._session, self._keeper, self._sensor = session, keeper, sensor
        self._period_s = scene.group_period_s
        self._readings = deque(maxlen=_KEPT)
        self.groups = max(LEAST_GROUPS, math.ceil(_MEASURE_S / self._period_s))
        index = scene.sensor_names.index(sensor)
        planned = session.reader.plan.sensors[index]
        untouched_deg = planned.model.untouched_deg(scene.radio.center_frequency_hz)
        self._made_of = index, sensor, untouched_deg, planned.stated.off_reflection, self._period_s
        stream = session.reader.stream
        self._on_groups, stream.on_groups = stream.on_groups, self._note

    def _note(self, groups):
        """Keep the readings of a batch; in the thread of the reader."""
        self._on_groups(groups)
        self._readings.extend(uncalibrated_readings(groups, *self._made_of))

    def idle(self):
        """Check that the session goes on; DeviceLost when the device is gone."""
        self._keeper.look()
        if self._session.reader.failure is not None:
            raise self._session.reader.failure

    def collect(self, idle):
        """Readings of the first groups that begin after this call."""
        begin_s = self._session.time_s + self._period_s / 2

        def found():
            return [each for each in list(self._readings) if each.time_s >= begin_s]

        patience_s = _PATIENCE_S + 8 * self.groups * self._period_s
        if not self._wait(lambda: len(found()) >= self.groups, patience_s, idle):
            rule = f"must give {self.groups} readings; is its tag on, and in reach?"
            raise InputError(f"sensor '{self._sensor}'", rule, len(found()))
        return found()[: self.groups]

    @staticmethod
    def _wait(come, patience_s, idle):
        """Whether something has come before the patience ends."""
        end = time.monotonic() + patience_s
        while not come():
            if time.monotonic() > end:
                return False
            idle()
            time.sleep(_LOOK_S)
        return True

    def wait_for_reference(self, idle):
        """Wait until readings come that are not part of the untouched reference."""

        def measured():
            return self._readings and "reference" not in self._readings[-1].flags

        if not self._wait(measured, _START_PATIENCE_S, idle):
            rule = "must give readings; run `gr-wiforce check` with the same scene and gains"
            raise InputError(f"sensor '{self._sensor}'", rule)


_WAIT_S = 0.05
_CHUNK_BYTES = 4096


class OperatorLines:
    """Reads lines of a terminal or a pipe, by default standard input, without blocking others."""

    def __init__(self, descriptor=0):
        self._descriptor = descriptor
        self._rest, self._ended = b"", False

    def next(self, idle):
        """Wait for a line, and return it without its end; None at the end of input."""
        while b"\n" not in self._rest:
            if self._ended:
                return None
            idle()
            if select.select([self._descriptor], [], [], _WAIT_S)[0]:
                data = os.read(self._descriptor, _CHUNK_BYTES)
                self._ended = not data
                # A last line counts without its end as well.
                self._rest += data or (b"\n" if self._rest else b"")
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()


_SCALE_BYTES = 65536
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
        """Take what has arrived, or the first part of it; whether there was any."""
        data = self._read()
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        self._rest = rest[-_SCALE_BYTES:]
        for line in lines:
            if line.strip():
                self._take(line.decode("utf-8", "replace"))
        return bool(data)

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
        if stat.S_ISREG(os.fstat(self._descriptor).st_mode):
            while self.poll():
                pass
            self.gauge = ForceGauge(str(path), now_s=time.monotonic())

    def close(self):
        os.close(self._descriptor)

    def _read(self):
        try:
            return os.read(self._descriptor, _SCALE_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror})") from error

    def _take(self, line):
        cells = [cell.strip() for cell in next(csv.reader([line.lstrip("\ufeff")]), [])]
        if self._column is None:
            if "force_n" not in cells:
                rule = "must have a header with a column force_n"
                raise InputError(self._path, rule, line.strip())
            self._column = cells.index("force_n")
            return
        with suppress(IndexError, InputError):
            self.gauge.note_force(time.monotonic(), parse_force(cells[self._column]))


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
            return self._port.read(_SCALE_BYTES)
        except self._failure as error:
            raise InputError(self.gauge.name, f"cannot be read any more ({error})") from error


_OPTION_OF = {"location_mm": "--locations", "force_n": "--forces", "sweeps": "--sweeps"}


def check_guided(live, guided):
    """Refuse options of ``--live`` that were typed without it."""
    context = click.get_current_context()
    for name in () if live else guided:
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            option = name.replace("scene_path", "scene").replace("_", "-")
            raise click.UsageError(f"--{option} needs --live.", context)


def table_of(table, output, live):
    """Path of the table: the argument, or with ``--live`` a file beside the output by default."""
    if table is None and not live:
        raise click.UsageError("Missing argument 'TABLE'.", click.get_current_context())
    if table is None:
        return str(Path(output).with_suffix(".taps.csv"))
    if live and Path(table).suffix.lower() != ".csv":
        raise InputError(table, "file of a session must end in .csv")
    return table


def guide(table, guided, settings):
    """Lead a person through measurements stored in ``table``; the carrier in Hz, None if quit."""
    from gnuradio.wiforce.calibration.session import CalibrationSession, SessionPlan
    from gnuradio.wiforce.scene import load_scene

    for name, option in (("scene_path", "--scene"), ("args", "--args")):
        if guided[name] is None:
            raise InputError(option, "must be given with --live")
    scene, name = load_scene(guided.pop("scene_path")), guided.pop("sensor")
    meant = [each for each in scene.sensors if name in (None, each.name)]
    if len(meant) != 1:
        rule = f"must be one of the scene's: {', '.join(scene.sensor_names)}"
        raise InputError("--sensor", rule, *([] if name is None else [name]))
    (sensor,) = meant
    own_mm = sensor.load_model(scene).length_mm
    if own_mm != settings["length_mm"]:
        rule = f"must be that of the scene's model '{sensor.model}', {own_mm:g}"
        raise InputError("--length-mm", rule, settings["length_mm"])
    wanted = {"location_mm": guided.pop("locations"), "force_n": guided.pop("forces")}
    try:
        plan = SessionPlan(
            sensor=sensor.name,
            frequency_hz=scene.radio.center_frequency_hz,
            **{key: numbers for key, numbers in wanted.items() if numbers is not None},
            sweeps=guided.pop("sweeps"),
            length_mm=settings["length_mm"],
            permittivity=settings["permittivity"],
        )
    except InputError as error:
        raise error.renamed(_OPTION_OF) from None
    scale = [guided.pop(name) for name in ("scale", "scale_unit", "baud")]
    session = CalibrationSession(plan, table, settings)
    finished = False
    try:
        with ExitStack() as opened:
            gauge = None if scale[0] is None else opened.enter_context(closing(open_scale(*scale)))
            finished = _measure(session, scene, gauge, **guided)
    finally:
        if not finished and session.presses:
            stored = f"presses stored in {session.path}: {len(session.presses)}"
            click.echo(f"\n{stored}; the same command continues.")
    return plan.frequency_hz if finished else None


def _measure(session, scene, scale, args, **radio):
    """Run the dialogue with a device; whether it came to its end."""
    from ..live.live import radio_request
    from ..live.radio_keeper import RUNNING, RadioKeeper, warn_of_oscillators
    from ..live.session import LiveSession
    from ..radio.request import DeviceLost
    from ..shell.interrupts import FAILED
    from ..shell.log import log
    from .dialogue import GuidedCalibration

    request = radio_request(args, scene, **radio)
    live = LiveSession(scene, request, lambda reading: None)
    keeper = RadioKeeper(request, live, on_open=warn_of_oscillators)
    presses = LivePresses(live, keeper, session.plan.sensor, scene)
    dialogue = GuidedCalibration(session, presses, OperatorLines(), click.echo, scale)
    try:
        while keeper.state != RUNNING:
            presses.idle()
            time.sleep(_LOOK_S)
        return dialogue.run()
    except DeviceLost as lost:
        click.echo()
        log.error(str(lost))
        raise click.exceptions.Exit(FAILED) from lost
    finally:
        keeper.stop()
        live.stop()
