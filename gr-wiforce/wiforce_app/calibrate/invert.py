# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce invert``: phases measured by anything to readings."""

import math

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.readings import ESTIMATES, WEAK_FORCE_N, WEAK_PHASE_DEG, Reading
from gnuradio.wiforce.io.text.textfile import cell_number, read_csv
from gnuradio.wiforce.sensor.inversion import DEFAULT_STD_DEG
from gnuradio.wiforce.sensor.model import touch_of
from gnuradio.wiforce.signal.carrier import wrap_deg

from ..shell.commands import GroupedHelp
from ..shell.log import log
from ..shell.options import CARRIER_HZ, Number, readings_output, sensor_names

_NEEDED = ("phase1_deg", "phase2_deg")
_LARGEST = 1e12  # of any number: phases of more have no digits left for degrees


@click.command(cls=GroupedHelp, examples=("invert phases.csv --sensor arm.yaml -o forces.csv",))
@click.argument("phases", type=click.Path())
@click.option(
    "--sensor",
    "model",
    required=True,
    shell_complete=sensor_names,
    help="Shipped sensor or SENSOR.yaml.",
)
@readings_output
@click.option(
    "--frequency-hz", type=CARRIER_HZ, help="Carrier, where it is not the sensor's only one."
)
@click.option(
    "--std-deg", type=Number(), help="Standard deviation of the phases; 1 deg when not given."
)
@click.option("--tracked", is_flag=True, help="Follow each press over time_s, as a live reader.")
@click.option("--smoothed", is_flag=True, help="Read each press as a whole, over time_s.")
def invert(phases, model, output, frequency_hz, std_deg, tracked, smoothed):
    """Invert a CSV of PHASES (phase1_deg, phase2_deg; optionally time_s, sensor, location_mm).

    Where location_mm is given it is taken as known, unless location_std_mm says that it is a
    reading itself: readings can be inverted again.
    """
    from gnuradio.wiforce.calibration.mistakes import phase_suspicions
    from gnuradio.wiforce.sensor import load_sensor

    if std_deg is not None and std_deg <= 0:
        raise InputError("--std-deg", "must be positive", std_deg)
    if tracked and smoothed:
        raise click.UsageError("--tracked and --smoothed exclude each other")
    sensor = load_sensor(model, frequency_hz=frequency_hz)
    if frequency_hz is None and len(sensor.frequencies_hz) > 1:
        held = ", ".join(f"{frequency:g}" for frequency in sensor.frequencies_hz)
        raise InputError("--frequency-hz", f"must be one of the sensor's carriers, {held}")
    writer = open_writer(output, (phases, model))
    rows = _read(phases)
    std = DEFAULT_STD_DEG if std_deg is None else std_deg
    known = np.array([row["location_mm"] for row in rows])
    try:
        for text in phase_suspicions(sensor, _phases(rows), std, known, frequency_hz):
            log.warning(f"{phases}: {text}")
        if tracked or smoothed:
            readings = _over_time(phases, rows, sensor, frequency_hz, std, smoothed)
        else:
            readings = _one_by_one(rows, sensor, frequency_hz, std)
    except InputError as error:
        raise error.renamed({"location_mm": f"{phases}: location_mm"}) from error
    with writer:
        writer.write_all(readings)


def _read(path):
    header, rows = read_csv(path)
    if "y_mm" in header:
        rule = "holds readings of a surface, which are not computed from one sensor's phases: "
        raise InputError(path, f"{rule}`gr-wiforce read` computes them from the capture")
    for column in _NEEDED:
        if column not in header:
            raise InputError(path, f"must have a column {column}", ", ".join(header))
    return [_numbers(path, number, row) for number, row in rows]


def _numbers(path, number, row):
    group = (row.get("group") or "").strip()
    parsed = {"sensor": row.get("sensor") or "", "group": int(group) if group.isdigit() else None}
    where = f"{path}: row {number}"
    for column in _NEEDED:
        parsed[column] = cell_number(row, column, where, largest=_LARGEST)
    for column in ("time_s", "location_mm", "location_std_mm"):
        parsed[column] = cell_number(row, column, where, empty=math.nan, largest=_LARGEST)
    if parsed["location_std_mm"] > 0:
        parsed["location_mm"] = math.nan
    return parsed


def _phases(rows):
    """Phases of both ports, in degrees; (n, 2)."""
    return np.array([[row[column] for column in _NEEDED] for row in rows])


def _one_by_one(rows, sensor, frequency_hz, std):
    """A reading per row, each by itself."""
    phases = _phases(rows)
    known = np.array([row["location_mm"] for row in rows])
    touch = touch_of(sensor, phases, std, frequency_hz)
    readings = [
        _reading(row, sensor, std, state) for row, state in zip(rows, touch.tolist(), strict=True)
    ]
    for given in (True, False):
        chosen = np.flatnonzero((np.isfinite(known) == given) & (touch == 1))
        if len(chosen):
            places = known[chosen] if given else None
            result = sensor.invert(phases[chosen], std, places, frequency_hz)
            for i, index in enumerate(chosen):
                readings[index] = _reading(rows[index], sensor, std, 1, _values(result, i))
    return readings


def _over_time(path, rows, sensor, frequency_hz, std, smoothed):
    """A reading per row, every sensor's presses followed from touch to release."""
    readings = [None] * len(rows)
    for name in dict.fromkeys(row["sensor"] for row in rows):
        own = [i for i, row in enumerate(rows) if row["sensor"] == name]
        period = _period(path, [rows[i]["time_s"] for i in own])
        phases = _phases([rows[i] for i in own])
        touch = touch_of(sensor, phases, std, frequency_hz)
        follow = _smoothed if smoothed else _tracked
        values = follow(sensor, phases, std, touch == 1, period, frequency_hz)
        for i, found, state in zip(own, values, touch.tolist(), strict=True):
            readings[i] = _reading(rows[i], sensor, std, state, found)
    return readings


def _period(path, times):
    steps = np.diff(times)
    if not (len(steps) and np.all(np.isfinite(steps)) and np.all(steps > 0)):
        rule = "must be given and increase from row to row, for --tracked and --smoothed"
        raise InputError(f"{path}: time_s", rule)
    return float(np.median(steps))


def _tracked(sensor, phases, std, touched, period, frequency_hz):
    tracker = sensor.tracker(period, frequency_hz)
    found = [
        tracker.update(pair, std, bool(touch)) for pair, touch in zip(phases, touched, strict=True)
    ]
    return [values if touch else None for values, touch in zip(found, touched, strict=True)]


def _smoothed(sensor, phases, std, touched, period, frequency_hz):
    from gnuradio.wiforce.sensor import smooth_press

    values = [None] * len(phases)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touched.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        result = smooth_press(sensor, phases[start:stop], std, period, frequency_hz)
        values[start:stop] = [_values(result, i) for i in range(stop - start)]
    return values


def _values(result, i):
    """Force, its std, location, its std and flags of one reading."""
    return (*(float(getattr(result, name)[i]) for name in ESTIMATES), result.flags[i])


def _reading(row, sensor, std, touch, found=None):
    """A row's reading; ``touch`` is -1 where it is unknown, ``found`` None where not touched."""
    common = {
        "time_s": row["time_s"],
        "sensor": row["sensor"] or sensor.name,
        "phase1_deg": float(wrap_deg(row["phase1_deg"])),
        "phase2_deg": float(wrap_deg(row["phase2_deg"])),
        "group": row["group"],
    }
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
