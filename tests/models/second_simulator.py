# SPDX-License-Identifier: GPL-3.0-or-later
"""What captures that somebody else made consist of, written from the signal model alone.

It shares no line with the product: own sounding frame, own contact law, own writers. ``rooms``
puts tags into rooms and makes captures of it.
"""

import csv
import json
from dataclasses import dataclass
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


def frame():
    """Five repetitions of a chirp on 62 subcarriers, unit power, then silence; shape (720,)."""
    n = np.arange(64)
    symbol = sum(
        np.exp(1j * np.pi * k * k / 64) * np.exp(2j * np.pi * k * n / 64)
        for k in range(-31, 32)
        if k
    ) / np.sqrt(62)
    return np.concatenate([symbol] * 5 + [np.zeros(400)])


def channels(samples):
    """H on 62 subcarriers, frame by frame, from samples that begin with one; shape (n, 62)."""
    k = np.r_[-31:0, 1:32]
    folded = samples.reshape(-1, FRAME)[:, 64:320].reshape(-1, 4, 64).mean(axis=1)
    sent = np.exp(1j * np.pi * k * k / 64) * 64 / np.sqrt(62)
    return np.fft.fft(folded.astype(complex))[:, k] / sent


def delayed(samples, delay_s):
    """A periodic signal, later by any delay."""
    f = np.fft.fftfreq(len(samples), 1 / RATE)
    return np.fft.ifft(np.fft.fft(samples) * np.exp(-2j * np.pi * f * delay_s))


def subcarrier_power(samples):
    """Mean of |H|^2 over the subcarriers, from one received frame of a still channel."""
    return np.mean(np.abs(channels(samples)) ** 2)


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


def switched(first_cycles, second_cycles, slope, duty=(0.25, 0.25)):
    """How far each switch is on at instants of its clock; edges take 1 / slope of a cycle."""
    to_first = np.abs(first_cycles - np.round(first_cycles))
    half = 2 * second_cycles - 0.5
    to_second = np.abs(half - np.round(half)) / 2
    return [
        np.clip(0.5 + (width - distance) * slope, 0, 1)
        for distance, width in ((to_first, duty[0] / 2), (to_second, duty[1] / 4))
    ]


def write_capture(blocks, path, rate_hz=RATE):
    """14-bit codes in the upper bits of ci16, and SigMF metadata."""
    with open(f"{path}.sigmf-data", "wb") as stream:
        for block in blocks:
            codes = block.reshape(-1).view(block.real.dtype) * block.real.dtype.type(8192)
            np.clip(np.rint(codes, out=codes), -8192, 8191, out=codes)
            (codes.astype("<i2") * np.int16(4)).tofile(stream)
    meta = {
        "global": {
            "core:datatype": "ci16_le",
            "core:sample_rate": rate_hz,
            "core:version": "1.0.0",
        },
        "captures": [{"core:sample_start": 0, "core:frequency": CARRIER_HZ}],
        "annotations": [],
    }
    Path(f"{path}.sigmf-meta").write_text(json.dumps(meta))


def write_vna(tag, path, rng):
    """Phase against force at five locations and both ports, and untouched; noise of 0.1 deg."""
    with open(path, "w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["freq_mhz", "location_mm", "port", "force_n", "phase_deg"])
        for location in ("", *CALIBRATED_MM):
            forces = np.zeros(5) if location == "" else np.arange(1.0, 8.01, 0.25)
            psi = phases(tag, forces, np.full(len(forces), 40.0 if location == "" else location))
            psi = (psi + 0.1 * rng.standard_normal(psi.shape) + 180) % 360 - 180
            for port in (1, 2):
                for force, phase in zip(forces, psi[:, port - 1], strict=True):
                    rows.writerow([CARRIER_HZ / 1e6, location, port, force, round(phase, 4)])
