# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's other published series: two sensors, distances and fingertips, as it measured them.

Each is one of its figures as a table; nothing here is simulated, but link budgets are computed.
"""

from dataclasses import replace

import numpy as np
from gnuradio.wiforce.scene import load_scene

from .causes import FOLDER

# Twice the paper's median force error of one sensor: what it expects of the sum, not a measurement.
EXPECTED_SUM_N = 1.12
# Where the fingertips pressed, and the distance within which the paper counts them as located.
FINGERTIP_MM, WITHIN_MM = 60.0, 10.0


def read_series(name):
    """A published series as an array with named columns."""
    return np.genfromtxt(FOLDER / f"{name}.csv", delimiter=",", names=True)


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
    """`snr_db` at the published distances by the link budget of the scene `distance_1m`.

    Its definition (docs/reference/scenes.md) is not the paper's, which is unknown: only differences
    between distances compare.
    """
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
