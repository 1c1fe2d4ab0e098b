# SPDX-License-Identifier: GPL-3.0-or-later
"""How accurate a scene's readings will be: phases from the Cramer-Rao bound, force and location
from what the reader's model makes of them. Nothing is simulated."""

from dataclasses import dataclass, field

import numpy as np

from ..estimation.bound import phase_bound_deg
from ..estimation.tag_clock import harmonics
from .channel import PEAK

# Median of |x| for a Gaussian x of unit standard deviation.
MEDIAN = 0.6745
# The untouched phases of a calibration are taken as the mean of so many sweeps.
_UNTOUCHED_SWEEPS = 10
# Groups over which the bound is computed are not longer than this; it scales with their length.
_LONGEST = 1250
# Peak of noise in standard deviations of a component.
_NOISE_PEAK = 4.5


@dataclass(frozen=True)
class Levels:
    """What reaches the receiver, in units of a tag's rho; noise per subcarrier and snapshot.

    ``noise`` is the variance in H of what the scene's ``snr_db`` says, ``quantisation`` that of
    the ADC's steps; ``tag_steps`` is the amplitude of the first tag's line +1 in ADC steps, and
    ``noise_steps`` the standard deviation of a sample's noise component.
    """

    noise: float
    quantisation: float
    tag_steps: float
    noise_steps: float


@dataclass(frozen=True)
class Expected:
    """What is expected of one sensor.

    Attributes
    ----------
    sensor : str
    phase_std_deg : (float, float)
        Noise of the phases of a reading while nothing changes.
    phase_error_deg : (float, float)
        Median error: noise, and what the calibration left open in the untouched phases.
    force_error_n, location_error_mm : float
        Median error over the presses: noise and the model's own error.
    presses : tuple
        (force_n, location_mm, force std, location std) of each representative press.
    """

    sensor: str
    phase_std_deg: tuple
    phase_error_deg: tuple
    force_error_n: float
    location_error_mm: float
    presses: tuple = field(repr=False)


def receive_levels(scene):
    """What the receiver gets: the strongest path is brought to the simulator's peak level."""
    simulation, waveform = scene.simulation, scene.waveform()
    line = float(harmonics(1, scene.sensors[0].clock_hz * waveform.averaging_s)[0])
    noise = line**2 / 10 ** (simulation.snr_db / 10)
    sample_std = np.sqrt(noise / waveform.channel_noise_gain / 2)
    clutter = [simulation.static_clutter_db, simulation.moving_clutter_db]
    amplitudes = [line * 10 ** (db / 20) for db in clutter if db is not None]
    amplitudes += [10 ** (tag.level_db / 20) for tag in simulation.tags]
    peak = sum(amplitudes) * float(np.abs(waveform.frame()).max()) + _NOISE_PEAK * sample_std
    step = peak / PEAK / 2 ** ((simulation.adc_bits or 16) - 1)
    quantisation = 2 * step**2 / 12 * waveform.channel_noise_gain
    return Levels(noise, float(quantisation), float(line / step), float(sample_std / step))


def expect(scene, plan):
    """Expected errors of every sensor of a scene.

    Parameters
    ----------
    scene : Scene
        Its ``simulation`` gives noise, clutter and presses; without presses the calibrated span
        of force and location is taken.
    plan : Plan

    Returns
    -------
    tuple of Expected
    """
    noise = receive_levels(scene)
    variance = noise.noise + noise.quantisation
    points = [_presses(scene, i) for i in range(len(scene.sensors))]
    phases = [
        model.phases_deg(*points[i].T, scene.radio.center_frequency_hz)
        for i, model in enumerate(_models(scene))
    ]
    bound = _bound_deg(scene, plan, phases, variance)
    found = []
    for i, (sensor, model) in enumerate(zip(scene.sensors, _models(scene), strict=True)):
        std = _reading_std(sensor, phases[i], bound[2 * i : 2 * i + 2])
        untouched = np.array(model.noise_deg(scene.radio.center_frequency_hz))
        untouched = untouched / np.sqrt(_UNTOUCHED_SWEEPS)
        total = np.hypot(std, untouched)
        spread = _spread(model, scene.radio.center_frequency_hz, points[i], total)
        medians = MEDIAN * np.median(spread, axis=0)
        found.append(
            Expected(
                sensor.name,
                tuple(std.tolist()),
                tuple((MEDIAN * total).tolist()),
                float(medians[0]),
                float(medians[1]),
                tuple(map(tuple, np.hstack([points[i], spread]).tolist())),
            )
        )
    return tuple(found)


def _models(scene):
    return [sensor.load_model(scene) for sensor in scene.sensors]


def _presses(scene, index):
    """Representative (force, location) of a sensor; shape (n, 2)."""
    sensor = scene.sensors[index]
    own = [p for p in scene.simulation.presses if p.sensor == sensor.name]
    share = np.array([0.0, 0.5, 1.0])
    if own:
        return np.array(
            [
                (p.force_n + s * (p.end_force_n - p.force_n), p.location_mm)
                for p in own
                for s in share
            ]
        )
    model = sensor.load_model(scene)
    spans = [
        low + share * (high - low) for low, high in (model.force_span_n, model.location_span_mm)
    ]
    return np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 2)


def _bound_deg(scene, plan, phases, variance):
    """Standard deviation of arg R of every end; shape (2S,)."""
    waveform = plan.waveform
    length = min(plan.group_length, _LONGEST)
    times_s = np.arange(length) * waveform.snapshot_period_s
    subcarriers = len(waveform.bins)
    ends, clocks = [], []
    for i, (sensor, tag) in enumerate(zip(scene.sensors, scene.simulation.tags, strict=True)):
        reflections = np.exp(1j * np.radians(phases[i]))
        size = np.sqrt(np.mean(np.abs(reflections - sensor.off_reflection) ** 2, axis=0))
        ends += [np.full(subcarriers, 10 ** (tag.level_db / 20) * s, complex) for s in size]
        clocks.append((sensor.clock_hz, 1.0 + 2.4 * i))
    bound = phase_bound_deg(
        np.array(ends),
        np.full(subcarriers, variance),
        clocks,
        times_s,
        waveform.averaging_s,
        plan.clutter_hz,
        np.inf,
    )
    groups = plan.group_length / length
    share = 1 / plan.smoothing_groups + 1 / plan.reference_groups
    loss = 10 ** (np.array(plan.loss_db) / 10) if plan.loss_db else 1.0
    return bound * np.sqrt(loss * share / groups)


def _reading_std(sensor, phases, bound):
    """From arg R to psi, whose slope is |D| / |G| on average over the presses; shape (2,)."""
    reflections = np.exp(1j * np.radians(phases))
    return bound * np.sqrt(np.mean(np.abs(reflections - sensor.off_reflection) ** 2, axis=0))


def _spread(model, frequency_hz, points, phase_std_deg):
    """Standard deviations of force and location at each press; shape (n, 2)."""
    forward = model.inverter(frequency_hz).forward
    at = forward.clip(*points.T)
    slopes = forward.slopes(*at)
    variance = phase_std_deg**2 + _model_variance(model, frequency_hz, *points.T)
    normal = np.einsum("npa,npb,np->nab", slopes, slopes, 1 / variance)
    # no more can be unknown than the domain is wide
    normal[:, 0, 0] += 12 / np.ptp(forward.force_n) ** 2
    normal[:, 1, 1] += 12 / np.ptp(forward.location_mm) ** 2
    return np.sqrt(np.einsum("naa->na", np.linalg.inv(normal)))


def _model_variance(model, frequency_hz, force_n, location_mm):
    """Variance of the model's phases that is to be expected; shape (n, 2).

    Between calibrated locations a model claims what its interpolation might err at worst. What it
    does err by was seen when locations were left out: there the gaps are twice as wide, and
    interpolation errs at least twice as much.
    """
    rows = getattr(model, "cross_validation", {}).get("locations", [])
    rows = [r for r in rows if abs(r["frequency_mhz"] * 1e6 - frequency_hz) < 1e-3 * frequency_hz]
    if not rows:
        return model.model_std_deg(force_n, location_mm, frequency_hz) ** 2
    calibrated = model.carriers[model.carrier_index(frequency_hz)].location_mm
    nearest = calibrated[np.argmin(np.abs(location_mm[:, None] - calibrated), axis=1)]
    fitted = model.model_std_deg(force_n, nearest, frequency_hz) ** 2
    between = (location_mm != nearest)[:, None]
    left_out = np.stack([_left_out_deg(rows, port, location_mm) for port in (1, 2)], axis=-1)
    return fitted + np.where(between, (left_out / 2) ** 2, 0.0)


def _left_out_deg(rows, port, location_mm):
    """Rms error where locations were left out, drawn to other locations; shape (n,)."""
    own = sorted((r["location_mm"], r["rms_deg"]) for r in rows if r["port"] == port)
    places, errors = zip(*own, strict=True)
    return np.interp(location_mm, places, errors)
