# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's figures, and its wireless trials, read with models made from its VNA curves.

Nothing is fitted to or chosen by a trial that is scored: the form of the curves by cross-validation
on the VNA data, the phases' scatter (and, where it says so, one calibration press per location) by
another trial. From trial 3 nothing is learnt.
"""

from itertools import product
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.calibration.calibrate import calibrate, refine
from gnuradio.wiforce.calibration.tables import CalibrationTable, read_vna_csv
from gnuradio.wiforce.io.text.textfile import check_output, read_yaml, write_csv
from gnuradio.wiforce.sensor import PressTracker
from gnuradio.wiforce.signal.carrier import wrap_deg

from ..shell.log import progress
from ..shell.tables import Column, table

FOLDER = Path(DATA_DIR) / "data" / "paper"


def paper_figures():
    """The paper's figures by shipped scene, those of distances with their error bars."""
    figures = read_yaml(FOLDER / "figures.yaml")
    for figure in figures.values():
        if "distance_m" in figure:
            value, error = published_phase_std(figure["distance_m"])
            figure["phase_rms_deg"], figure["error_bar"] = value, error
            bar = f"{value - error:.2f} to {value + error:.2f} deg"
            figure["text"] = f"phase std {bar} at {figure['distance_m']:g} m"
    return figures


def published_phase_std(distance_m):
    """Published standard deviation of the phase at a receiver's distance, and its error bar."""
    path = FOLDER / "distance_phase_std.csv"
    rows = np.genfromtxt(path, delimiter=",", names=True)
    row = rows[rows["distance_from_rx_cm"] == round(100 * distance_m)][0]
    return float(row["phase_std_deg"]), float(row["err_plus_deg"])


FREQUENCIES_HZ = (900e6, 2400e6)
# Each trial, and the one that its readings' scatter and refined models are learnt from.
LEARNT_FROM = {"1": "2", "2": "1", "3": "2"}
METHODS = ("location known", "single reading", "smoother")
ONSET_FORCE_N = 0.9
# A press sweeps about 7 N in some fifteen readings; a reading counts as the tracker's second.
_WALK_N_PER_READING = 0.5
# Where the published offsets make both phases move alike with force and with location.
UNOBSERVABLE_MM = 40.0

# Median errors claimed by the paper, on a test set of its own: force (N), location (mm).
CLAIMS = {900e6: (0.56, 0.86), 2400e6: (0.34, 0.59)}


def published_presses():
    """Rows of each published wireless press, without what trial 3 repeats of trial 2."""
    presses = []
    for name in ("wireless.csv", "wireless_trial3.csv"):
        table = read_vna_csv(FOLDER / name)
        columns = table.frequency_hz, table.location_mm, table.press
        for frequency, location, trial in dict.fromkeys(zip(*columns, strict=True)):
            own = (columns[0] == frequency) & (columns[1] == location) & (columns[2] == trial)
            presses.append(table.take(own))
    return presses


def forces_and_phases(press):
    """Forces (n,) of a press, which both ports share, and their phases (n, 2)."""
    first, second = (press.take(press.port == port) for port in (1, 2))
    return first.force_n, np.column_stack([first.phase_deg, second.phase_deg])


def score_presses(presses):
    """Every model and method on every reading of the presses, as a DataFrame in columns of `-o`.

    ``wireless_calibration``: with one press per location, of the other trial.
    """
    import pandas

    frames = []
    with progress("evaluating", 2 * len(FREQUENCIES_HZ) * len(LEARNT_FROM)) as step:
        for frequency in FREQUENCIES_HZ:
            table = read_vna_csv(FOLDER / "vna.csv", frequency)
            settings = 80.0, "auto-beyond", ONSET_FORCE_N  # the data choose the form of the curves
            name = f"paper-{frequency / 1e6:g}mhz"
            bench = calibrate(table, name, *settings, location_steps="given")
            own = [press for press in presses if press.frequency_hz[0] == frequency]
            for (trial, learnt_from), refined in product(LEARNT_FROM.items(), (False, True)):
                other = [press for press in own if press.press[0] == learnt_from]
                model = refine(bench, CalibrationTable.joined(other)) if refined else bench
                std = model.noise_deg() if refined else _scatter(bench, other)
                frames += [
                    pandas.DataFrame(
                        {
                            "freq_mhz": frequency / 1e6,
                            "form": bench.form,
                            "wireless_calibration": int(refined),
                            "method": method,
                            "location_mm": press.location_mm[0],
                            "trial": trial,
                            **_read_press(model, std, press, method),
                        }
                    )
                    for press, method in product(own, METHODS)
                    if press.press[0] == trial
                ]
                step(1)
    return pandas.concat(frames, ignore_index=True)


def _scatter(model, presses):
    """Root mean square (2,) of the phases about the model's, in other presses."""
    away = []
    for press in presses:
        force_n, phases = forces_and_phases(press)
        away.append(wrap_deg(phases - model.phases_deg(force_n, press.location_mm[0])))
    return np.sqrt(np.mean(np.concatenate(away) ** 2, axis=0))


def _read_press(model, std, press, method):
    """Columns of the forces and readings of a press."""
    force_n, phases = forces_and_phases(press)
    if method == "smoother":
        tracker = PressTracker(model, 1.0, force_walk_n=_WALK_N_PER_READING)
        found = tracker.smooth(phases, std)
    else:
        known = press.location_mm[0] if method == "location known" else None
        found = model.invert(phases, std, location_mm=known)
    return {
        "force_n": force_n,
        "estimated_force_n": found.force_n,
        "force_std_n": found.force_std_n,
        "estimated_location_mm": found.location_mm,
        "location_std_mm": found.location_std_mm,
        "flags": [" ".join(words) for words in found.flags],
    }


def errors(scores):
    """Absolute errors of force and location of some rows of `score_presses`."""
    force = (scores.estimated_force_n - scores.force_n).abs()
    return force, (scores.estimated_location_mm - scores.location_mm).abs()


@click.command()
@click.option(
    "-o", "--output", type=click.Path(), help="Write every reading with its errors (CSV)."
)
def paper(output):
    """Score the models on the paper's wireless trials."""
    if output is not None:
        check_output(output)
    scores = score_presses(published_presses())
    if output is not None:
        shown = {key: scores[key].map("{:g}".format) for key in ("freq_mhz", "location_mm")}
        write_csv(output, scores.assign(**shown))
    for frequency, own in scores.groupby("freq_mhz"):
        _print_frequency(1e6 * frequency, own)
    click.echo(f"limits of these data, and the paper's other series: {FOLDER}")


_TRIALS = (
    Column("calibrated by VNA and", "calibrated"),
    Column("method", "method"),
    Column("force error (N)", "force"),
    Column("location error (mm)", "location"),
    Column("n", "n"),
    Column("in 2 std", "within", ".0%"),
)


def _print_frequency(frequency, scores):
    force, location = CLAIMS[frequency]
    presses = len(scores.groupby(["trial", "location_mm"]))
    click.echo(f"{frequency / 1e6:g} MHz, {presses} published wireless presses of trials 1 to 3")
    click.echo(f"paper, own test set: median {force:.2f} N, {location:.2f} mm")
    click.echo(f"curves chosen by cross-validation on the VNA data: {scores.form.iloc[0]}")
    click.echo("errors: median, 90th percentile")
    click.echo()
    away = f"not {UNOBSERVABLE_MM:g} mm"
    rows = []
    for refined in (0, 1):
        for method in METHODS:
            own = scores[(scores.wireless_calibration == refined) & (scores.method == method)]
            calibrated = "one wireless press per location" if refined else "nothing else"
            rows.append({"calibrated": calibrated, "method": method, **_errors(own)})
            if method == "single reading":
                other = own[own.location_mm != UNOBSERVABLE_MM]
                rows.append({**rows[-1], "method": f"{method}, {away}", **_errors(other)})
    click.echo(f"{table(rows, _TRIALS)}\n")


def _errors(scores):
    """Cells of a method's readings."""
    force, location = errors(scores)
    known = scores.method.iloc[0] == "location known"
    return {
        "force": _distribution(force),
        "location": "known" if known else _distribution(location),
        "n": len(scores),
        "within": np.mean(force <= 2 * scores.force_std_n),
    }


def _distribution(errors):
    return f"{errors.median():.2f}, {errors.quantile(0.9):.2f}"
