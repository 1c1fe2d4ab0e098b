# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's figures, and its wireless trials, read with models made from its VNA curves.

Nothing is fitted to or chosen by a trial that is scored: the form of the curves by cross-validation
on the VNA data, the phases' scatter (and, where it says so, one calibration press per location) by
another trial. From trial 3 nothing is learnt.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.calibration.calibrate import calibrate, refine
from gnuradio.wiforce.calibration.tables import CalibrationTable, read_vna_csv
from gnuradio.wiforce.io.text.textfile import read_yaml
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.sensor import PressTracker
from gnuradio.wiforce.signal.carrier import wrap_deg

from ..shell.log import progress

FOLDER = Path(DATA_DIR) / "data" / "paper"
# Twice the paper's median force error of one sensor: what it expects of the sum, not a measurement.
EXPECTED_SUM_N = 1.12
# Where the fingertips pressed, and the distance within which the paper counts them as located.
FINGERTIP_MM, WITHIN_MM = 60.0, 10.0


def read_series(name):
    """A published series as an array with named columns."""
    return np.genfromtxt(FOLDER / f"{name}.csv", delimiter=",", names=True)


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
    rows = read_series("distance_phase_std")
    row = rows[rows["distance_from_rx_cm"] == round(100 * distance_m)][0]
    return float(row["phase_std_deg"]), float(row["err_plus_deg"])


def sum_errors_n():
    """Errors of the sum of two sensors against one load cell; the last load has no estimate."""
    rows = read_series("two_sensor")
    errors = rows["est_sum_n"] - rows["load_cell_sum_n"]
    return errors[np.isfinite(errors)]


def located_share():
    """Share of the fingertip presses in the bins within `WITHIN_MM` of where they pressed."""
    rows = read_series("finger_histogram")
    near = np.abs(rows["bin_left_mm"] + 5 - FINGERTIP_MM) < WITHIN_MM
    return float(rows["probability"][near].sum())


def budgeted_snr_db():
    """`snr_db` at the published distances by a link budget; only differences compare."""
    scene = load_scene("distance_1m")
    clock_hz, link = scene.sensors[0].clock_hz, scene.simulation.link
    for distance_cm in read_series("distance_snr")["distance_from_rx_cm"]:
        receiver_m = float(distance_cm) / 100
        moved = replace(link, receiver_m=receiver_m, transmitter_m=link.antennas_m - receiver_m)
        settings = scene.radio.center_frequency_hz, scene.waveform(), clock_hz
        yield moved.levels_db(*settings)[0]


def series_lines():
    """All of them as lines for a terminal."""
    errors = np.abs(sum_errors_n())
    beyond = np.count_nonzero(errors > EXPECTED_SUM_N)
    yield "Two sensors pressed together, the sum of their forces against one load cell"
    yield (
        f"paper: median {np.median(errors):.2f} N, largest {errors.max():.2f} N, n = {len(errors)};"
        f" {beyond} lie beyond the {EXPECTED_SUM_N} N that it expects (twice 0.56 N)"
    )
    yield "ours, simulated: gr-wiforce evaluate two_sensors"
    yield ""
    rows = read_series("finger_histogram")
    bins = zip(rows["bin_left_mm"], rows["bin_right_mm"], rows["probability"], strict=True)
    shown = ", ".join(f"{100 * p:.3g} % {low:g}-{high:g}" for low, high, p in bins if p)
    yield f"Fingertips at {FINGERTIP_MM:g} mm and 2.4 GHz, where they were located (mm)"
    yield f"paper: {shown}; {100 * located_share():.0f} % within {WITHIN_MM:g} mm"
    yield "ours, simulated: gr-wiforce evaluate fingertip"
    yield ""
    snr, phase = read_series("distance_snr"), read_series("distance_phase_std")
    yield "Distance from the receiver, 900 MHz, antennas 4 m apart; ours by the link budget"
    yield f"{'m':>5}{'paper: SNR (dB)':>20}{'phase std (deg)':>20}{'ours: snr_db':>15}"
    for level, std, ours in zip(snr, phase, budgeted_snr_db(), strict=True):
        db = _bar(level["snr_db"], level["err_minus_db"], level["err_plus_db"])
        deg = _bar(std["phase_std_deg"], std["err_minus_deg"], std["err_plus_deg"])
        yield f"{level['distance_from_rx_cm'] / 100:5.1f}{db:>20}{deg:>20}{ours:>15.1f}"
    yield ""


def _bar(value, minus, plus):
    """An error bar of the paper, which does not say how many standard deviations it has."""
    return f"{value - minus:.2f} to {value + plus:.2f}"


FREQUENCIES_HZ = (900e6, 2400e6)
# Each trial, and the one that its readings' scatter and refined models are learnt from.
LEARNT_FROM = {"1": "2", "2": "1", "3": "2"}
METHODS = ("location known", "single reading", "smoother")
ONSET_FORCE_N = 0.9
# A press sweeps about 7 N in some fifteen readings; a reading counts as the tracker's second.
_WALK_N_PER_READING = 0.5
# Where the published offsets make both phases move alike with force and with location.
UNOBSERVABLE_MM = 40.0
_RESAMPLES = 1000

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


def bench_model(table):
    """The model of VNA data, whose curves have the form that these choose."""
    name = f"paper-{table.frequency_hz[0] / 1e6:g}mhz"
    return calibrate(table, name, 80.0, "auto-beyond", ONSET_FORCE_N, location_steps="given")


def score_presses(vna_path, presses):
    """Every model and method on every reading of the presses, as a DataFrame in columns of `-o`.

    ``wireless_calibration``: with one press per location, of the other trial.
    """
    import pandas

    frames = []
    with progress("evaluating", 2 * len(FREQUENCIES_HZ) * len(LEARNT_FROM)) as step:
        for frequency in FREQUENCIES_HZ:
            bench = bench_model(read_vna_csv(vna_path, frequency))
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


def bootstrap_median(errors):
    """95 % interval of the pooled median: presses drawn, then readings within each."""
    rng = np.random.default_rng(1)
    medians = []
    for _ in range(_RESAMPLES):
        drawn = rng.integers(len(errors), size=len(errors))
        parts = [rng.choice(errors[i], size=len(errors[i])) for i in drawn]
        medians.append(np.median(np.concatenate(parts)))
    low, high = np.quantile(medians, [0.025, 0.975])
    return float(low), float(high)
