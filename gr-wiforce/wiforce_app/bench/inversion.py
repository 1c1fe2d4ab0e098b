# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench inversion``: time per reading of every sensor, in batches and alone."""

import time

import click
import numpy as np

from ..shell.log import progress
from ..shell.tables import Column, echo, table

_BATCH, _SINGLE, _RUNS = 20_000, 1000, 7
_NOISES_DEG = (0.2, 1.0)
_LEAST_N = 0.02  # errors below it are ignored
COLUMNS = (
    Column("sensor", "sensor"),
    Column("noise (deg)", "noise_deg", "g"),
    Column("batch (us)", "batch_us", ".2f"),
    Column("single (us)", "single_us", ".1f"),
    Column("in 2 std", "within_2_std", ".1%"),
    Column("clear, beyond 3 std", "beyond_3_std", ".2%"),
    Column("flagged", "flagged", ".1%"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Rows as JSON instead of a table.")
@click.option("--sensor", "names", multiple=True, help="Only this sensor; a name or SENSOR.yaml.")
def inversion(as_json, names):
    """Time per reading, in a batch and one by one, for presses all over each sensor's span.

    Medians, on one processor. Beside them, the share of forces within two standard deviations of
    the truth, that of readings without a flag beyond three (Gaussian: 0.27 %), and that of flagged
    ones.
    """
    from gnuradio.wiforce.sensor import load_sensor, shipped_sensors

    names = names or shipped_sensors()
    models = [load_sensor(name) for name in names]
    cases = [(model, carrier) for model in models for carrier in model.frequencies_hz]
    rows = []
    with progress("inverting", len(cases) * len(_NOISES_DEG)) as step:
        for model, carrier in cases:
            for noise_deg in _NOISES_DEG:
                rows.append(_measure(model, carrier, noise_deg))
                step(1)
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def _measure(model, carrier, noise_deg):
    rng = np.random.default_rng(1)
    force, _, phases = random_presses(model, carrier, _BATCH, rng)
    phases += noise_deg * rng.standard_normal(phases.shape)
    inverter = model.inverter(carrier)
    batch = [_seconds(inverter.invert, phases, noise_deg) for _ in range(_RUNS)]
    singles = phases[:_SINGLE, None]
    single = [_seconds(inverter.invert, pair, noise_deg) for pair in singles]
    found = inverter.invert(phases, noise_deg)
    error = np.abs(found.force_n - force)
    clear = np.array([not flags for flags in found.flags])
    beyond = clear & ~(error <= 3 * np.hypot(found.force_std_n, _LEAST_N))
    return {
        "sensor": model.name,
        "carrier_mhz": carrier / 1e6,
        "noise_deg": noise_deg,
        "batch_us": round(float(np.median(batch)) / len(phases) * 1e6, 2),
        "single_us": round(float(np.median(single)) * 1e6, 1),
        "within_2_std": round(float(np.mean(error <= 2 * found.force_std_n)), 4),
        "beyond_3_std": round(float(np.sum(beyond) / max(1, np.sum(clear))), 4),
        "flagged": round(float(np.mean(~clear)), 4),
    }


def random_presses(model, carrier, count, rng):
    """Force, location (n,) and phases (n, 2) of at most so many presses, all over a sensor."""
    force = rng.uniform(*model.force_span_n, count)
    location = rng.uniform(*model.location_span_mm, count)
    inside = model.in_span(force, location) & (force >= model.onset_force_n)
    force, location = force[inside], location[inside]
    return force, location, model.phases_deg(force, location, carrier)


def _seconds(function, *arguments):
    began = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - began
