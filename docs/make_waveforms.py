#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/waveforms.png and prints docs/data/waveforms.csv.

build/run python3 docs/make_waveforms.py
"""

from pathlib import Path

import numpy as np
from gnuradio.wiforce.io.palette import SERIES
from gnuradio.wiforce.signal.bound import phase_bound_deg
from gnuradio.wiforce.signal.waveform import sounding_waveform
from matplotlib.figure import Figure

PICTURE = Path(__file__).resolve().parent / "images" / "waveforms.png"
RATE_HZ = 12.5e6
READING_S = 0.036
# Names, and lengths of their symbols.
SHIPPED = (
    ("repeated", 64),
    ("wifi", 64),
    ("chirp", 64),
    ("chirp", 128),
    ("chirp", 1024),
    ("fmcw", 128),
    ("fmcw", 1024),
    ("zadoff-chu", 63),
    ("zadoff-chu", 1023),
)
# At their points, those that lie together once.
LABELS = {
    ("repeated", 64): "repeated 64",
    ("wifi", 64): "wifi 64",
    ("chirp", 64): "chirp 64, 128, 1024",
    ("fmcw", 128): "fmcw 128, 1024",
    ("zadoff-chu", 63): "zadoff-chu 63",
    ("zadoff-chu", 1023): "zadoff-chu 1023",
}
TICKS_DEG = (0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12, 0.13)
CLOCKS_HZ = (100.0, 400.0, 1000.0)


def waveform_of(name, length, rate_hz=RATE_HZ, repetitions=5, guard=0):
    if name == "wifi":
        return sounding_waveform(name, 320 + guard, rate_hz)
    return sounding_waveform(
        name,
        repetitions * length + guard,
        rate_hz,
        symbol_length=length,
        repetitions=repetitions,
        averaged_repetitions=max(repetitions - 1, 1),
    )


def std_deg(waveform, clock_hz, density, power=1.0):
    """Standard deviation of a reading's phases by the bound, the worse end; NaN beyond Nyquist.

    `density` is that of the noise in units of power per Hz, `power` the mean while symbols are
    sent.
    """
    if 8 * clock_hz * waveform.snapshot_period_s >= 1:
        return np.nan
    count = max(int(READING_S / waveform.snapshot_period_s), 8)
    samples = waveform.repetitions * waveform.symbol_length * waveform.used_share
    noise = density * waveform.sample_rate_hz / (samples * power)
    times_s = np.arange(count) * waveform.snapshot_period_s
    clocks = [(clock_hz, 0.3)]
    return phase_bound_deg(
        np.ones((2, 1)), np.full(1, noise), clocks, times_s, waveform.averaging_s
    ).max()


def unit_density():
    """Noise with which the default frame reads with 0.1 deg."""
    return (0.1 / std_deg(waveform_of("repeated", 64, guard=400), 1000.0, 1.0)) ** 2


def main():
    density = unit_density()
    canvas = Figure(figsize=(13, 5), layout="constrained")
    bandwidth, frame_rate, papr = canvas.subplots(1, 3, sharey=True)
    _draw_bandwidth(bandwidth, density)
    _draw_frame_rate(frame_rate, density)
    _draw_papr(papr, density)
    bandwidth.set_ylabel("noise of a reading's phases (deg)")
    bandwidth.set_yticks(TICKS_DEG)
    bandwidth.set_yticks([], minor=True)
    canvas.savefig(PICTURE, dpi=100)


def _finish(axis):
    """Numbers without exponents, and a legend below."""
    axis.xaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_major_formatter("{x:g}")
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, fontsize=8)


def _draw_curves(axis, curves, points):
    """Noise over what ``points`` says, for clocks and lengths of symbols; 64 samples are solid."""
    for clock_hz, length in curves:
        axis.loglog(
            *points(clock_hz, length),
            "-" if length == 64 else "--",
            color=SERIES[CLOCKS_HZ.index(clock_hz)],
            label=f"{length} samples, {clock_hz:g} Hz",
        )
    _finish(axis)


def _draw_bandwidth(axis, density):
    rates_hz = np.geomspace(0.5e6, 50e6, 41)

    def points(clock_hz, length):
        waveforms = (waveform_of("chirp", length, rate) for rate in rates_hz)
        return rates_hz / 1e6, [std_deg(each, clock_hz, density) for each in waveforms]

    axis.set_xlabel("bandwidth (MHz)")
    axis.set_title("same mean power, 5 symbols, no guard")
    _draw_curves(axis, [(clock, n) for clock in CLOCKS_HZ for n in (64, 1024)], points)


def _draw_frame_rate(axis, density):
    counts = np.unique(np.geomspace(2, 400, 60).astype(int))

    def points(clock_hz, length):
        waveforms = [waveform_of("chirp", length, repetitions=int(count)) for count in counts]
        rates = [1 / each.snapshot_period_s for each in waveforms]
        return rates, [std_deg(each, clock_hz, density) for each in waveforms]

    axis.set_xlabel("frame rate (1/s)")
    axis.set_title("12.5 MHz, same mean power, no guard")
    _draw_curves(axis, [(clock, n) for n in (64, 256) for clock in CLOCKS_HZ], points)


def peak_to_average_db(symbol):
    """PAPR in dB of the band-limited signal through the samples of a repeated symbol."""
    length = len(symbol)
    spectrum, half = np.fft.fft(symbol), (length + 1) // 2
    wide = np.zeros(8 * length, complex)
    wide[:half], wide[half - length :] = spectrum[:half], spectrum[half:]
    power = np.abs(np.fft.ifft(wide)) ** 2
    return float(10 * np.log10(power.max() / power.mean()))


def _draw_papr(axis, density):
    print("waveform,symbol,subcarriers,bandwidth,PAPR,noise at the same peak power")
    reference = None
    for name, length in SHIPPED:
        waveform = waveform_of(name, length)
        peak_db = peak_to_average_db(waveform.symbol)
        std = std_deg(waveform, 100.0, density, 10 ** (-peak_db / 10))
        reference = reference or std
        axis.semilogy(peak_db, std, "o", color=SERIES[0])
        if (name, length) in LABELS:
            place = {"xytext": (-8, 0), "ha": "right"} if peak_db > 5 else {"xytext": (8, 0)}
            text = LABELS[name, length]
            axis.annotate(text, (peak_db, std), textcoords="offset points", va="center", **place)
        low, high = waveform.outermost_hz
        print(
            f"{name},{length},{len(waveform.subcarriers)},{(high - low) / 1e6:.1f} MHz,"
            f"{peak_db:.1f} dB,{20 * np.log10(std / reference):+.1f} dB"
        )
    axis.set_xlabel("PAPR (dB)")
    axis.set_xlim(1, 6.5)
    axis.set_title("same peak power, 100 Hz clock, no guard")
    _finish(axis)


if __name__ == "__main__":
    main()
