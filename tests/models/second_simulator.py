# SPDX-License-Identifier: GPL-3.0-or-later
"""A second simulator, written from the signal model alone: captures made by somebody else.

It shares no line with the product: own sounding frame, own clocks, own contact law, own writers.
Each case leaves in its folder what a user would have: a VNA table per sensor, a scene that names
the sensor model still to be calibrated from it, and a capture.

    python3 tests/models/second_simulator.py CASE FOLDER
"""

import csv
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

RATE = 12.5e6
FRAME = 720
GROUP = 625  # frames
CARRIER_HZ = 900e6
ACTIVE = 344  # samples of a frame that hold signal: the preamble and its last echoes
LENGTH_MM = 80.0
ROUND_TRIP_DEG_PER_MM = 2 * 360 * CARRIER_HZ / 299792458.0 / 1000
CALIBRATED_MM = (20, 30, 40, 50, 60)


@dataclass(frozen=True)
class Line:
    """A line that is pressed: it is shorted from one edge to the other, wider with more force.

    With the default values the nearer end's edge moves about 4.6 mm over 2-8 N, the farther one's
    1.1 mm.
    """

    length_mm: float = LENGTH_MM
    width_mm: float = 2.1
    soft_n: float = 0.8  # force beyond the onset after which the short widens slowly
    tilt: float = 0.62
    lean: float = 0.0  # tilt in the middle: 0 for a line whose ends are alike
    permittivity: float = 1.0
    swapped: bool = False  # its ends are connected to the switches the other way round

    def edges(self, force, location):
        """Edges of the short, (from port 1, from port 2) in mm."""
        width = self.width_mm * np.log1p(np.maximum(force - 0.7, 0) / self.soft_n)
        tilt = self.lean + self.tilt * (40 - location) / np.hypot(40 - location, 9.0)
        return location - width * (1 + tilt), self.length_mm - location - width * (1 - tilt)


@dataclass
class Tag:
    name: str = "finger"
    clock_hz: float = 1000.0
    offset_ppm: float = 25.0
    drift_ppm_per_s: float = 0.3
    level_db: float = 0.0
    off: complex = 0.0
    port_deg: tuple = (37.0, -81.0)
    line: Line = Line()
    # (start, rise, hold, force at the beginning and end of hold, location)
    presses: tuple = ((0.7, 0.05, 0.55, 3.0, 5.5, 33.0), (1.65, 0.05, 0.55, 6.0, 4.0, 54.0))


@dataclass
class Case:
    snr_db: float
    static_db: float
    movers_db: float | None = None
    movers_hz: float = 0.0
    tags: tuple = field(default_factory=lambda: (Tag(),))
    duration_s: float = 2.5


CASES = {
    "leaky": Case(10, 50, tags=(Tag(off=0.15 * np.exp(2.1j)),)),
    "moving": Case(5, 70, 30, 60.0, tags=(Tag(offset_ppm=95, drift_ppm_per_s=-0.5),)),
    "faint": Case(-15, 40),
    "pair": Case(
        10,
        50,
        tags=(
            Tag("left", presses=((0.7, 0.05, 0.9, 3.0, 6.0, 35.0),)),
            Tag(
                "right",
                1400.0,
                -60.0,
                0.2,
                -3.0,
                port_deg=(-12.0, 55.0),
                presses=((0.9, 0.05, 0.9, 5.0, 2.5, 47.0),),
            ),
        ),
        duration_s=2.2,
    ),
}


def frame():
    """Five repetitions of a chirp on 62 subcarriers, unit power, then silence; shape (720,)."""
    n = np.arange(64)
    symbol = sum(
        np.exp(1j * np.pi * k * k / 64) * np.exp(2j * np.pi * k * n / 64)
        for k in range(-31, 32)
        if k
    ) / np.sqrt(62)
    return np.concatenate([symbol] * 5 + [np.zeros(400)])


def delayed(samples, delay_s):
    """A periodic signal, later by any delay."""
    f = np.fft.fftfreq(len(samples), 1 / RATE)
    return np.fft.ifft(np.fft.fft(samples) * np.exp(-2j * np.pi * f * delay_s))


def subcarrier_power(samples):
    """Mean of |H|^2 over the subcarriers, from one received frame of a still channel."""
    k = np.r_[-31:0, 1:32]
    received = np.fft.fft(samples[64:320].reshape(4, 64).mean(axis=0))[k]
    return np.mean(np.abs(received / (np.exp(1j * np.pi * k * k / 64) * 64 / np.sqrt(62))) ** 2)


def phases(tag, force, location):
    """psi_1, psi_2 in degrees; shape (..., 2). Below 0.9 N nothing touches."""
    line = tag.line
    slope = ROUND_TRIP_DEG_PER_MM * np.sqrt(line.permittivity)
    touched = 180 - slope * np.stack(line.edges(force, location), axis=-1)
    psi = np.where(force[..., None] >= 0.9, touched, -slope * line.length_mm)
    return (psi[..., ::-1] if line.swapped else psi) + np.array(tag.port_deg)


def pressed(tag, t):
    """Force and location at times t."""
    force, location = np.zeros_like(t), np.full_like(t, 40.0)
    for start, rise, hold, first, last, place in tag.presses:
        knots = np.array([0, rise, rise + hold, 2 * rise + hold]) + start
        during = (t >= knots[0]) & (t <= knots[-1])
        force[during] = np.interp(t[during], knots, [0, first, last, 0])
        location[during] = place
    return force, location


def switches(tag, start_phase, t):
    """How far each switch is on at sample times t: edges are averaged over a sample."""
    o, d = tag.offset_ppm * 1e-6, tag.drift_ppm_per_s * 1e-6
    cycles = start_phase + tag.clock_hz * (t * (1 + o) + d * t * t / 2)
    samples_per_cycle = RATE / tag.clock_hz

    def on(distance_to_centre, half_width):
        return np.clip(0.5 + (half_width - distance_to_centre) * samples_per_cycle, 0, 1)

    first = np.abs(cycles - np.round(cycles))
    half = 2 * cycles - 0.5
    second = np.abs(half - np.round(half)) / 2
    return on(first, 1 / 8), on(second, 1 / 16)


class Mover:
    """A path that swings: its Doppler goes to and fro within the stated band."""

    def __init__(self, rng, highest_hz, amplitude, sent):
        self.late = delayed(sent, rng.uniform(0.3e-6, 0.6e-6))
        self.late *= amplitude / np.sqrt(subcarrier_power(self.late))
        self.rate = rng.uniform(0.3, 0.6)
        self.steady = highest_hz * rng.uniform(-0.4, 0.4)
        self.swing = 0.35 * highest_hz / self.rate
        self.phase = rng.uniform(0, 2 * np.pi, 2)

    def gain(self, t):
        swing = self.swing * np.sin(2 * np.pi * self.rate * t + self.phase[0])
        return np.exp(1j * (2 * np.pi * self.steady * t + swing + self.phase[1]))


def simulate(case, rng):
    """Received samples in blocks of whole groups: float, peak 3 dB below 1.

    Yields arrays of shape (625, 720), one per group.
    """
    sent = frame()
    averaging = np.sinc(case.tags[0].clock_hz * 256 / RATE)
    line = 0.25 * np.sinc(0.25) * averaging
    still = np.zeros(FRAME, complex)
    for delay, level in zip(rng.uniform(5e-8, 5e-7, 6), (1, 0.3, 0.2, 0.2, 0.1, 0.1), strict=True):
        still += level * np.exp(2j * np.pi * rng.random()) * delayed(sent, delay)
    still *= line * 10 ** (case.static_db / 20) / np.sqrt(subcarrier_power(still))
    by_tag = [10 ** (tag.level_db / 20) * delayed(sent, 0.15e-6) for tag in case.tags]
    start_phases = rng.random(len(case.tags))
    movers = []
    if case.movers_db is not None:
        amplitude = line * 10 ** (case.movers_db / 20) / np.sqrt(3)
        movers = [Mover(rng, case.movers_hz, amplitude, sent) for _ in range(3)]
    noise_h = line / 10 ** (case.snr_db / 20)
    noise = noise_h * np.sqrt(4 * 64 / 62)
    parts = [still, *by_tag, *(m.late for m in movers)]
    scale = 10 ** (-3 / 20) / (sum(np.abs(p) for p in parts).max() + 3.5 * noise)
    inside = np.arange(ACTIVE) / RATE
    for first in range(0, int(case.duration_s * RATE / FRAME) // GROUP * GROUP, GROUP):
        start = (first + np.arange(GROUP)) * FRAME / RATE
        t = start[:, None] + inside
        received = np.empty((GROUP, FRAME), np.complex128)
        received[:] = still
        for tag, late, phase in zip(case.tags, by_tag, start_phases, strict=True):
            psi = np.deg2rad(phases(tag, *pressed(tag, start + 16e-6)))
            ends = np.exp(1j * psi)[:, None, :]
            s1, s2 = switches(tag, phase, t)
            r = s1 * ends[..., 0] + s2 * ends[..., 1] + (1 - s1 - s2) * tag.off
            received[:, :ACTIVE] += late[:ACTIVE] * r
        for mover in movers:
            received[:, :ACTIVE] += mover.late[:ACTIVE] * mover.gain(t)
        normal = rng.standard_normal((GROUP, FRAME, 2), dtype=np.float32)
        received += noise / np.sqrt(2) * normal.view(np.complex64)[..., 0]
        yield scale * received


def write_capture(blocks, path):
    """14-bit codes in the upper bits of ci16, and SigMF metadata."""
    with open(f"{path}.sigmf-data", "wb") as stream:
        for block in blocks:
            codes = block.reshape(-1).view(block.real.dtype) * block.real.dtype.type(8192)
            np.clip(np.rint(codes, out=codes), -8192, 8191, out=codes)
            (codes.astype("<i2") * np.int16(4)).tofile(stream)
    meta = {
        "global": {
            "core:datatype": "ci16_le",
            "core:sample_rate": RATE,
            "core:version": "1.0.0",
        },
        "captures": [{"core:sample_start": 0, "core:frequency": CARRIER_HZ}],
        "annotations": [],
    }
    Path(f"{path}.sigmf-meta").write_text(json.dumps(meta))


def write_vna(tag, path, rng, noise_deg=0.1):
    """Phase against force at five locations and both ports, and the untouched phases."""
    with open(path, "w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["freq_mhz", "location_mm", "port", "force_n", "phase_deg"])
        for location in ("", *CALIBRATED_MM):
            forces = np.zeros(5) if location == "" else np.arange(1.0, 8.01, 0.25)
            psi = phases(tag, forces, np.full(len(forces), 40.0 if location == "" else location))
            psi = (psi + noise_deg * rng.standard_normal(psi.shape) + 180) % 360 - 180
            for port in (1, 2):
                for force, phase in zip(forces, psi[:, port - 1], strict=True):
                    rows.writerow([CARRIER_HZ / 1e6, location, port, force, round(phase, 4)])


def write_scene(case, path):
    """What a user knows: clocks within 100 ppm, the off state, how fast things move."""
    lines = ["sensors:"]
    for tag in case.tags:
        off = complex(tag.off)
        lines.append(
            f"  - {{name: {tag.name}, model: {tag.name}.yaml, clock_hz: {tag.clock_hz:g}, "
            f"clock_tolerance_ppm: 100, off_reflection: [{off.real!r}, {off.imag!r}]}}"
        )
    lines += [
        f"radio: {{center_frequency_hz: {CARRIER_HZ!r}, sample_rate_hz: {RATE!r}}}",
        f"environment: {{moving_clutter_hz: {case.movers_hz!r}}}",
        "reference_s: 0.5",
    ]
    Path(path).write_text("\n".join(lines) + "\n")


def write_case(name, folder, seed=7):
    """All files of a case: ``capture.*``, ``scene.yaml``, ``SENSOR.csv`` (VNA).

    The scene names the sensor models ``SENSOR.yaml``, to be calibrated from ``SENSOR.csv``.
    """
    case, folder = CASES[name], Path(folder)
    rng = np.random.default_rng(seed)
    for tag in case.tags:
        write_vna(tag, folder / f"{tag.name}.csv", rng)
    write_scene(case, folder / "scene.yaml")
    write_capture(simulate(case, rng), folder / "capture")
    return case


if __name__ == "__main__":
    write_case(sys.argv[1], sys.argv[2])
