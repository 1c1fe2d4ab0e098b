#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/press.gif: a simulated finger, and what the reader says of it.

build/run python3 docs/make_press_animation.py
"""

import tempfile
from pathlib import Path

import numpy as np
import pandas
from gnuradio import wiforce
from gnuradio.wiforce.io.palette import BEAM, FAINT, GRID, GROUND, SERIES, TRUTH
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image

PICTURE = Path(__file__).resolve().parent / "images" / "press.gif"
SECONDS, FRAMES_PER_S, SENSOR, LENGTH_MM = 10.0, 10, "arm", 80.0
PRESSES = (  # start (s), first and last force (N), location (mm)
    (1.0, 2.0, 6.0, 28.0),
    (4.0, 7.0, 3.0, 47.0),
    (7.0, 1.5, 4.5, 38.0),
)
FORCE, LOCATION = SERIES[:2]
MM_PER_N, SOFTNESS_MM, DEEPEST_MM = 3.2, 7.0, 3.0
COLORS = 64


def measured(folder):
    """Readings of simulated presses, and the truth, by time."""
    scene = {
        "radio": {"sample_rate_hz": 1.25e6},
        "sounding": {"frame_length": 320},
        "phase_group": {"snapshots": 125},
        "sensors": [{"name": SENSOR, "model": "line-900mhz-calibrated", "clock_hz": 400}],
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": SECONDS,
            "snr_db": 12,
            "static_clutter_db": 50,
            "presses": [
                {"start_s": start, "hold_s": 1.8, "rise_s": 0.3}
                | {"force_n": first, "end_force_n": last, "location_mm": place}
                for start, first, last, place in PRESSES
            ],
        },
    }
    wiforce.simulate(scene, folder / "press")
    readings = wiforce.read(folder / "press")
    return readings[readings["ok"]], pandas.read_csv(folder / "press.truth.csv")


class Picture:
    """The sensor above, force and location over time below."""

    def __init__(self, readings, truth):
        self.readings, self.truth = readings, truth
        self.canvas = Figure(figsize=(7.2, 4.4), layout="constrained")
        self.sensor, self.force, self.location = self.canvas.subplots(
            3, 1, height_ratios=(1.5, 1, 1)
        )
        self._draw_sensor()
        self._draw_curves()

    def _draw_sensor(self):
        axis = self.sensor
        axis.set(xlim=(-6, LENGTH_MM + 6), ylim=(-9, 30), yticks=[])
        axis.set_xticks(range(0, 81, 20), [f"{place} mm" for place in range(0, 81, 20)])
        axis.spines[["top", "left", "right"]].set_visible(False)
        axis.plot([0, LENGTH_MM], [-6, -6], color="#B87333", lw=4, solid_capstyle="butt")
        axis.text(-1, -6, "port 1", ha="right", va="center", fontsize=8)
        axis.text(LENGTH_MM + 1, -6, "port 2", va="center", fontsize=8)
        self.beam = axis.plot([], [], color=GROUND, lw=5, solid_capstyle="round")[0]
        self.finger = axis.add_patch(
            FancyBboxPatch((0, 0), 3, 40, boxstyle="round,pad=1.5", fc=GRID, ec=BEAM)
        )
        self.arrow = axis.annotate(
            "",
            xy=(0, 0),
            xytext=(0, 0),
            arrowprops={"arrowstyle": "-|>", "color": FORCE, "lw": 3, "mutation_scale": 18},
        )
        top = {"transform": axis.transAxes, "va": "top"}
        self.words = axis.text(0.01, 0.95, "", fontsize=12, color=FORCE, **top)
        axis.text(
            0.99,
            0.95,
            "finger and radio signal: simulated\narrow and dots: what is read",
            fontsize=8,
            color=FAINT,
            ha="right",
            **top,
        )

    def _draw_curves(self):
        for axis, name, top, label in (
            (self.force, "force_n", 8, "force (N)"),
            (self.location, "location_mm", 80, "location (mm)"),
        ):
            axis.set(xlim=(0, SECONDS), ylim=(-0.05 * top, top), ylabel=label)
            axis.grid(alpha=0.3)
            touched = self.truth["touch"] == 1
            values = self.truth[name].where(touched, 0.0 if name == "force_n" else np.nan)
            axis.plot(self.truth["time_s"], values, color=TRUTH, lw=4, label="applied")
        self.force.set_xticklabels([])
        self.location.set_xlabel("time (s)")
        style = {"ls": "", "marker": ".", "ms": 4}
        self.forces = self.force.plot([], [], color=FORCE, label="measured", **style)[0]
        self.locations = self.location.plot([], [], color=LOCATION, label="measured", **style)[0]
        for axis in (self.force, self.location):
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)

    def show(self, time_s):
        """Everything up to one time."""
        past = self.readings[self.readings["time_s"] <= time_s]
        force_n = past["force_n"].where(past["touch"] == 1, 0.0)
        self.forces.set_data(past["time_s"], force_n)
        self.locations.set_data(past["time_s"], past["location_mm"])
        now = self.truth.iloc[int(np.argmin(np.abs(self.truth["time_s"] - time_s)))]
        pressed = now["touch"] == 1
        place = now["location_mm"] if pressed else np.nan
        along = np.linspace(0, LENGTH_MM, 200)
        depth = DEEPEST_MM * np.tanh(now["force_n"] / 2) if pressed else 0.0
        dent = depth * np.exp(-((along - place) ** 2) / (2 * SOFTNESS_MM**2)) if pressed else 0
        self.beam.set_data(along, -2.5 - dent + 0 * along)
        self.finger.set_visible(pressed)
        if pressed:
            self.finger.set_x(place - 1.5)
            self.finger.set_y(0.5 - depth)
        self._show_reading(past.iloc[-1] if len(past) else None, time_s)

    def _show_reading(self, reading, time_s):
        touched = reading is not None and reading["touch"] == 1
        self.arrow.set_visible(bool(touched))
        if touched:
            place, tip = reading["location_mm"], -4.0
            self.arrow.xy = place, tip
            self.arrow.set_position((place, tip + MM_PER_N * reading["force_n"]))
            text = f"{reading['force_n']:.1f} N at {reading['location_mm']:.1f} mm"
        else:
            text = "measuring the untouched sensor" if time_s < 0.5 else "untouched"
        self.words.set_text(text)


def main():
    with tempfile.TemporaryDirectory() as folder:
        picture = Picture(*measured(Path(folder)))
    agg = FigureCanvasAgg(picture.canvas)
    frames = []
    for time_s in np.arange(0, SECONDS, 1 / FRAMES_PER_S):
        picture.show(time_s)
        agg.draw()
        frames.append(Image.fromarray(np.asarray(agg.buffer_rgba())[..., :3]))
    # One palette for all frames, so that a frame stores only what has changed.
    palette = frames[len(frames) // 4].quantize(COLORS)
    kept = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    duration_ms = round(1000 / FRAMES_PER_S)
    kept[0].save(PICTURE, save_all=True, append_images=kept[1:], duration=duration_ms, loop=0)


if __name__ == "__main__":
    main()
