# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce invert``: phases measured by anything to readings."""

import csv
import math

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.readings import Reading, open_writer

_NEEDED = ("phase1_deg", "phase2_deg")


@click.command()
@click.argument("phases", type=click.Path())
@click.option("--sensor", "model", required=True, help="Shipped sensor or SENSOR.yaml.")
@click.option("-o", "--output", type=click.Path(), help="OUT.csv or OUT.jsonl; CSV on stdout.")
@click.option("--frequency-hz", type=float, help="Carrier, for a sensor that holds several.")
@click.option(
    "--std-deg", type=float, help="Standard deviation of the phases; 1 deg when not given."
)
def invert(phases, model, output, frequency_hz, std_deg):
    """Invert a CSV of PHASES (phase1_deg, phase2_deg; optionally time_s, sensor, location_mm).

    Where location_mm is given it is taken as known.
    """
    from gnuradio.wiforce.sensor import load_sensor

    if std_deg is not None and not (math.isfinite(std_deg) and std_deg > 0):
        raise InputError("--std-deg", "must be positive", std_deg)
    sensor = load_sensor(model)
    rows = _read(phases)
    readings = _readings(rows, sensor, frequency_hz, std_deg)
    writer = open_writer(output)
    try:
        for reading in readings:
            writer.write(reading)
    finally:
        writer.close()


def _read(path):
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            rows = list(reader)
            header = reader.fieldnames or []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"cannot be read ({error})") from error
    for column in _NEEDED:
        if column not in header:
            raise InputError(path, f"must have a column {column}", ", ".join(header))
    if not rows:
        raise InputError(path, "holds no row")
    return [_numbers(path, number, row) for number, row in enumerate(rows, 2)]


def _numbers(path, number, row):
    parsed = {"sensor": row.get("sensor") or ""}
    for column in (*_NEEDED, "time_s", "location_mm"):
        cell = (row.get(column) or "").strip()
        if not cell and column not in _NEEDED:
            parsed[column] = math.nan
            continue
        try:
            parsed[column] = float(cell)
        except ValueError:
            parsed[column] = math.nan
        if not math.isfinite(parsed[column]):
            raise InputError(f"{path}: row {number}: {column}", "must be a finite number", cell)
    return parsed


def _readings(rows, sensor, frequency_hz, std_deg):
    phases = np.array([[row[column] for column in _NEEDED] for row in rows])
    known = np.array([row["location_mm"] for row in rows])
    results = [None] * len(rows)
    for given in (True, False):
        chosen = np.flatnonzero(np.isfinite(known) == given)
        if len(chosen):
            result = sensor.invert(
                phases[chosen], std_deg, known[chosen] if given else None, frequency_hz
            )
            near = sensor.is_untouched(phases[chosen], std_deg, frequency_hz)
            for i, index in enumerate(chosen):
                results[index] = _reading(rows[index], sensor, result, i, near[i])
    return results


def _reading(row, sensor, result, i, untouched):
    common = {
        "time_s": row["time_s"],
        "sensor": row["sensor"] or sensor.name,
        "phase1_deg": row["phase1_deg"],
        "phase2_deg": row["phase2_deg"],
    }
    if untouched:
        return Reading(**common, touch=0)
    values = {
        key: None if not math.isfinite(getattr(result, key)[i]) else float(getattr(result, key)[i])
        for key in ("force_n", "force_std_n", "location_mm", "location_std_mm")
    }
    return Reading(**common, **values, touch=1, flags=tuple(result.flags[i]))
