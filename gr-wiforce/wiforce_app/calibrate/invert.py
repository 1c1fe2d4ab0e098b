# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce invert``: phases measured by anything to readings."""

import math

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.outputs import Outputs
from gnuradio.wiforce.io.readings import ESTIMATES, WEAK_FORCE_N, WEAK_PHASE_DEG, Reading
from gnuradio.wiforce.io.text.textfile import cell_number, read_csv, require_columns
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.inversion import DEFAULT_STD_DEG
from gnuradio.wiforce.sensor.model import touch_of
from gnuradio.wiforce.signal.carrier import wrap_deg

from ..shell.commands import GroupedHelp
from ..shell.log import log
from ..shell.options import CARRIER_HZ, FiniteRange, readings_outputs, sensor_names

_NEEDED = ("phase1_deg", "phase2_deg")
_LARGEST = 1e12  # of any number: phases of more have no digits left for degrees

_UNEXPLAINED = {"inconsistent", "extrapolated"}
_OF_ANOTHER = (
    "most phases do not fit the sensor: are the ports swapped, is the sign inverted (it must be "
    "that of arg S11, arg S22), or are they of another line or carrier?"
)


@click.command(cls=GroupedHelp, examples=("invert phases.csv --sensor arm.yaml -o forces.csv",))
@click.argument("phases", type=click.Path())
@click.option(
    "--sensor",
    "model",
    required=True,
    shell_complete=sensor_names,
    help="Shipped sensor or SENSOR.yaml.",
)
@readings_outputs()
@click.option(
    "--frequency-hz", type=CARRIER_HZ, help="Carrier, where it is not the sensor's only one."
)
@click.option(
    "--std-deg",
    type=FiniteRange(0, min_open=True),
    default=DEFAULT_STD_DEG,
    help="Standard deviation of the phases, in degrees.",
)
@click.option("--tracked", is_flag=True, help="Follow each press over time_s, as a live reader.")
@click.option("--smoothed", is_flag=True, help="Read each press as a whole, over time_s.")
def invert(phases, model, outputs, frequency_hz, std_deg, tracked, smoothed):
    """Invert a CSV of PHASES (phase1_deg, phase2_deg; optionally time_s, sensor, location_mm).

    Where location_mm is given it is taken as known, unless location_std_mm says that it is a
    reading itself: readings can be inverted again.
    """
    from gnuradio.wiforce.calibration.mistakes import radians_suspicion

    if tracked and smoothed:
        raise click.UsageError("--tracked and --smoothed exclude each other")
    sensor = load_sensor(model, frequency_hz=frequency_hz)
    if frequency_hz is None and len(sensor.frequencies_hz) > 1:
        held = ", ".join(f"{frequency:g}" for frequency in sensor.frequencies_hz)
        raise InputError("--frequency-hz", f"must be one of the sensor's carriers, {held}")
    writer = Outputs(*(open_writer(path, (phases, model)) for path in outputs or [None]))
    every = _read(phases)
    rows = [row for row in every if math.isfinite(row[_NEEDED[0]])]
    if not rows:
        raise InputError(phases, "must have a row with phases")
    measured = np.array([[row[column] for column in _NEEDED] for row in rows])
    known = np.array([row["location_mm"] for row in rows])
    try:
        touch = touch_of(sensor, measured, std_deg, frequency_hz)
        if tracked or smoothed:
            given = sensor, measured, std_deg, touch, frequency_hz
            found = dict(_over_time(phases, rows, *given, smoothed))
        else:
            pressed = np.flatnonzero(touch == 1)
            read = sensor.invert(measured[pressed], std_deg, known[pressed], frequency_hz)
            found = dict(zip(pressed.tolist(), _values(read), strict=True))
    except InputError as error:
        raise error.renamed({"location_mm": f"{phases}: location_mm"}) from error
    unexplained = [bool(_UNEXPLAINED & set(values[-1])) for values in found.values()]
    suspected = radians_suspicion(measured)
    if not suspected and unexplained and np.mean(unexplained) > 0.5:
        suspected = [_OF_ANOTHER]
    for text in suspected:
        log.warning(f"{phases}: {text}")
    for index, (row, state) in enumerate(zip(rows, touch.tolist(), strict=True)):
        row |= {"touch": state, "found": found.get(index)}
    with writer:
        writer.write_all(_reading(row, sensor.name, std_deg) for row in every)


def _read(path):
    """Sensor, flags, group, and phases, time and location or NaN of each row."""
    header, lines = read_csv(path)
    if "y_mm" in header:
        rule = "holds readings of a surface, which are not computed from one sensor's phases: "
        raise InputError(path, f"{rule}`gr-wiforce read` computes them from the capture")
    require_columns(path, header, _NEEDED)
    empty = dict.fromkeys(("time_s", "location_mm", "location_std_mm"), math.nan)
    rows = []
    for number, line in lines:
        where, group = f"{path}: row {number}", (line.get("group") or "").strip()
        # As `read` writes of a sensor that was not received.
        absent = not any((line[column] or "").strip() for column in _NEEDED)
        unknown = empty | (dict.fromkeys(_NEEDED, math.nan) if absent else {})
        row = {
            column: cell_number(line, column, where, unknown.get(column), _LARGEST)
            for column in (*_NEEDED, *empty)
        }
        if row["location_std_mm"] > 0:
            row["location_mm"] = math.nan
        group = int(group) if group.isdigit() else None
        texts = {column: line.get(column) or "" for column in ("sensor", "flags")}
        rows.append(row | texts | {"group": group})
    return rows


def _over_time(path, rows, sensor, phases, std, touch, frequency_hz, smoothed):
    """Touched rows, and what is found for each, sensors' presses followed from touch to release."""
    names, times = (np.array([row[key] for row in rows]) for key in ("sensor", "time_s"))
    for name in dict.fromkeys(names.tolist()):
        own = np.flatnonzero(names == name)
        steps = np.diff(times[own])
        if not (len(steps) and np.all(np.isfinite(steps)) and np.all(steps > 0)):
            rule = "must be given and increase from row to row, for --tracked and --smoothed"
            raise InputError(f"{path}: time_s", rule)
        tracker = sensor.tracker(float(np.median(steps)), frequency_hz)
        touched = touch[own] == 1
        if smoothed:
            edges = np.flatnonzero(np.diff(np.concatenate([[0], touched.astype(int), [0]])))
            for press in (own[slice(*ends)] for ends in edges.reshape(-1, 2)):
                read = tracker.smooth(phases[press], std)
                yield from zip(press.tolist(), _values(read), strict=True)
        else:
            # The tracker sees all rows, since a row without touch ends a press.
            for index, pressed in zip(own.tolist(), touched.tolist(), strict=True):
                values = tracker.update(phases[index], std, pressed)
                if pressed:
                    yield index, values


def _values(read):
    """Force, its std, location, its std and flags of each reading."""
    return zip(*(getattr(read, name).tolist() for name in ESTIMATES), read.flags, strict=True)


def _reading(row, sensor, std):
    """A row's reading: of a ``touch`` of -1, which is unknown, and ``found`` None without a touch.

    A row without phases has no value; it is flagged `gap` as stated, or not received.
    """
    common = {"time_s": row["time_s"], "sensor": row["sensor"] or sensor, "group": row["group"]}
    if "touch" not in row:
        return Reading(**common, flags=("gap" if "gap" in row["flags"].split() else "weak",))
    common |= {name: float(wrap_deg(row[name])) for name in _NEEDED}
    touch, found = row["touch"], row["found"]
    if found is None:
        flags = ("weak",) if std > WEAK_PHASE_DEG or touch < 0 else ()
        return Reading(**common, touch=None if touch < 0 else touch, flags=flags)
    *numbers, flags = found
    values = {
        key: value if math.isfinite(value) else None
        for key, value in zip(ESTIMATES, numbers, strict=True)
    }
    if std > WEAK_PHASE_DEG or not numbers[1] <= WEAK_FORCE_N:
        flags = ("weak", *flags)
    return Reading(**common, **values, touch=1, flags=tuple(flags))
