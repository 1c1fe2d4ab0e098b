# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about what a calibration does not support."""

import numpy as np

from ..signal.carrier import same_carrier
from . import line

_ENOUGH_LOCATIONS = 5
_UNEXPECTED = 3.0
_LARGEST_STEP_MM = 15.0
_FALL_DEG = 1.0
_VAGUE_MM = 0.5
_UNOBSERVABLE_PART = 0.2
_FORCES = 25


def calibration_warnings(model):
    """Lists what a calibrated model does not support.

    Parameters
    ----------
    model : CurveModel

    Returns
    -------
    list of str
        A sentence each; empty when there is nothing to warn of.
    """
    found = []
    for index, carrier in enumerate(model.carriers):
        at = f"{carrier.frequency_hz / 1e6:g} MHz: "
        own = [
            *_few_locations(model, carrier),
            *_cross_validation(model, carrier),
            *_misfit(carrier),
            *_steps(model, index),
            *_falls(model, index),
            *_unobservable(model, carrier),
        ]
        found += [at + text for text in own]
    return found


def _few_locations(model, carrier):
    places = carrier.location_mm
    texts = []
    if len(places) < _ENOUGH_LOCATIONS:
        texts.append(
            f"{len(places)} locations: five (20, 30, 40, 50, 60 mm) give sub-millimetre readings "
            "between them"
        )
    force = np.mean(model.force_span_n)
    middles = 0.5 * (places[1:] + places[:-1])
    std = model.model_std_deg(force, middles, carrier.frequency_hz).max(axis=1)
    std_mm = std / line.round_trip_deg_per_mm(carrier.frequency_hz, model.permittivity)
    for low, high, vague in zip(places[:-1], places[1:], std_mm, strict=True):
        if vague > _VAGUE_MM:
            texts.append(f"between {low:g} and {high:g} mm a short is known to {vague:.1f} mm only")
    return texts


def _cross_validation(model, carrier):
    rows = [
        row
        for row in model.cross_validation.get("locations", [])
        if same_carrier(row["frequency_mhz"] * 1e6, carrier.frequency_hz)
    ]
    return [
        f"location {row['location_mm']:g} mm does not fit the others: port {row['port']} is "
        f"{row['rms_deg']:.1f} deg from what they say ({row['expected_deg']:.1f} expected)"
        for row in rows
        if row["rms_deg"] > _UNEXPECTED * row["expected_deg"]
    ]


def _misfit(carrier):
    return [
        f"the curves do not fit port {port}: {misfit:.2f} deg of the scatter of {noise:.2f} deg "
        "are alike at neighbouring forces"
        for port, (noise, misfit) in enumerate(
            zip(carrier.noise_deg, carrier.misfit_deg, strict=True), 1
        )
        if misfit > 0.7 * noise
    ]


def _steps(model, index):
    carrier = model.carriers[index]
    places = carrier.location_mm
    force = np.full(len(places), np.mean(model.force_span_n))
    phases = model.short_deg(force, places, index)
    steps = np.diff(phases, axis=0)
    slope = line.round_trip_deg_per_mm(carrier.frequency_hz, model.permittivity)
    expected = np.outer(np.diff(places), [-slope, slope])
    worst = np.abs(steps - expected).max() / slope
    if worst <= _LARGEST_STEP_MM:
        return []
    return [
        f"phases of different locations do not fit a line: steps are up to {worst * slope:.0f} deg "
        f"({worst:.0f} mm) off; force and location read together are not to be trusted"
    ]


def _falls(model, index):
    force = np.linspace(*model.force_span_n, _FORCES)
    texts = []
    for place, span in zip(
        model.carriers[index].location_mm, model.carriers[index].force_span_n, strict=True
    ):
        inside = force[(force >= span[0]) & (force <= span[1])]
        phases = model.short_deg(inside, np.full(len(inside), place), index)
        falls = np.max(np.maximum.accumulate(phases, axis=0) - phases, axis=0)
        texts += [
            f"port {port} falls by {fall:.1f} deg with force at {place:g} mm; a short only widens"
            for port, fall in enumerate(falls, 1)
            if fall > _FALL_DEG
        ]
    return texts


def _unobservable(model, carrier):
    inverter = model.inverter(carrier.frequency_hz)
    force = np.linspace(*model.force_span_n, _FORCES)
    places = np.linspace(*model.location_span_mm, 9)
    unobservable = [
        place
        for place in places
        if np.mean(inverter.unobservable(force, np.full(_FORCES, place))) > _UNOBSERVABLE_PART
    ]
    if not unobservable:
        return []
    listed = ", ".join(f"{place:g}" for place in unobservable)
    return [f"force and location are hard to tell apart at {listed} mm (force-unobservable)"]
