# SPDX-License-Identifier: GPL-3.0-or-later
"""How accurate a scene's readings will be: noise of the phases from the Cramer-Rao bound, force and
location from what the reader's model makes of such phases. No samples are simulated."""

from dataclasses import dataclass

import numpy as np

from ..signal.bound import phase_bound_deg
from ..signal.carrier import same_carrier
from ..signal.switching import harmonics
from ..simulation.channel import NOISE_PEAK, PEAK
from ..simulation.presses import PressedSensor

# Median of |x| for a Gaussian x of unit standard deviation.
MEDIAN = 0.6745
# The untouched phases of a calibration are taken as the mean of so many sweeps.
_UNTOUCHED_SWEEPS = 10
# Groups over which the bound is computed are not longer than this; it scales with their length.
_LONGEST = 1250
# Groups of a scene whose readings are drawn at most, and drawings of each.
_GROUPS, _DRAWS = 300, 16
# Standard deviation of a noise component, in ADC steps, below which rounding is not like noise, and
# steps of the tag's line that are then too few.
_DITHER_STEPS, _FEW_STEPS = 0.3, 10


@dataclass(frozen=True)
class ReceivedLevels:
    """What reaches the receiver, in units of a tag's rho; noise per subcarrier and snapshot.

    ``noise`` is the variance in H of what the scene's ``snr_db`` says, ``quantisation`` that of
    the ADC's steps; ``tag_steps`` is the amplitude of the first tag's line +1 in ADC steps, and
    ``noise_steps`` the standard deviation of a sample's noise component.
    """

    noise: float
    quantisation: float
    tag_steps: float
    noise_steps: float

    @property
    def out_of_range(self):
        """Whether the tag is lost in the ADC's rounding, which errs systematically then."""
        return self.noise_steps < _DITHER_STEPS and self.tag_steps < _FEW_STEPS


@dataclass(frozen=True)
class Expected:
    """What is expected of one sensor.

    Attributes
    ----------
    sensor : str
    phase_std_deg : (float, float)
        Noise of the phases of a reading while nothing changes.
    phase_error_deg : (float, float) or None
        Median error of the phases' changes against the untouched sensor; None, as all below, for a
        sensor that is not readable.
    force_error_n, location_error_mm : float or None
        Median error while touched: noise, and what the reader's model errs by.
    """

    sensor: str
    phase_std_deg: tuple
    phase_error_deg: tuple | None
    force_error_n: float | None
    location_error_mm: float | None


def receive_levels(scene):
    """What the receiver gets: the strongest path is brought to the simulator's peak level."""
    simulation, waveform = scene.simulation, scene.waveform()
    line = float(harmonics(1, scene.sensors[0].clock_hz * waveform.averaging_s)[0])
    noise = line**2 / 10 ** (simulation.snr_db / 10)
    sample_std = np.sqrt(noise / waveform.channel_noise_gain / 2)
    clutter = [simulation.static_clutter_db, simulation.moving_clutter_db]
    amplitudes = [line * 10 ** (db / 20) for db in clutter if db is not None]
    amplitudes += [10 ** (tag.level_db / 20) for tag in simulation.tags]
    peak = sum(amplitudes) * float(np.abs(waveform.frame()).max()) + NOISE_PEAK * sample_std
    step = peak / PEAK / 2 ** ((simulation.adc_bits or 16) - 1)
    quantisation = 2 * step**2 / 12 * waveform.channel_noise_gain
    return ReceivedLevels(noise, float(quantisation), float(line / step), float(sample_std / step))


def expect(scene, plan):
    """Expected errors of every sensor of a scene.

    Parameters
    ----------
    scene : Scene
        Its ``simulation`` gives noise, clutter, presses, moves and the sensor that is pressed.
        Where nothing is pressed the calibrated span of force and location is taken, with the errors
        that the calibration itself claims.
    plan : Plan

    Returns
    -------
    tuple of Expected
    """
    levels = receive_levels(scene)
    carrier_hz = scene.radio.center_frequency_hz
    models = [sensor.load_model(scene) for sensor in scene.sensors]
    points = _pressed_points(scene, models)
    found = []
    stds = _phase_std(scene, plan, models, points, levels)
    for i, (sensor, model, std) in enumerate(zip(scene.sensors, models, stds, strict=True)):
        if why_not_readable(scene, i, levels):
            medians = None, None, None
        elif points[i] is None:
            medians = _claimed(model, carrier_hz, _span(model), std)
        else:
            medians = _drawn(model, carrier_hz, points[i], np.hypot(std, _curvature_deg(scene)))
        found.append(Expected(sensor.name, tuple(std.tolist()), *medians))
    return tuple(found)


def phase_std_deg(scene, plan):
    """``Expected.phase_std_deg`` of every sensor alone; shape (S, 2)."""
    models = [sensor.load_model(scene) for sensor in scene.sensors]
    return _phase_std(scene, plan, models, _pressed_points(scene, models), receive_levels(scene))


def _pressed_points(scene, models):
    """`_presses` of every sensor."""
    return [_presses(scene, i) for i in range(len(models))]


def _phase_std(scene, plan, models, points, levels):
    """Noise of the phases of readings; shape (S, 2)."""
    carrier_hz = scene.radio.center_frequency_hz
    phases = [
        model.phases_deg(*(_span(model) if p is None else p).T[:2], carrier_hz)
        for model, p in zip(models, points, strict=True)
    ]
    bound = _bound_deg(scene, plan, phases, levels.noise + levels.quantisation).reshape(-1, 2)
    return np.array(
        [_reading_std(*each) for each in zip(scene.sensors, phases, bound, strict=True)]
    )


def why_not_readable(scene, index, levels=None):
    """Why nothing can be read of a simulated scene's sensor; None when it can."""
    tag, levels = scene.simulation.tags[index], levels or receive_levels(scene)
    if levels.out_of_range:
        return (
            f"ADC range: beside the static path the tag's line has {levels.tag_steps:.2g} steps "
            f"and noise {levels.noise_steps:.2g}; rounding errs systematically, the tag is out of "
            "the ADC's range"
        )
    if scene.environment.reader_clock == "free" and scene.environment.receive_antennas == 1:
        return (
            "reader_clock free: one receive antenna cannot tell the common phase of transmitter "
            "and receiver from the tag in quadrature with the direct path"
        )
    if tag.clock2_duty != "pulses":
        return (
            f"both switches of '{tag.sensor}' are on together (clock2_duty: {tag.clock2_duty}): "
            "its ends cannot be told apart"
        )
    return None


def _curvature_deg(scene):
    """What the ratio of two antennas errs by, as it is not quite linear in the tag: up to
    |T| / |S| in the reference and again in the reading; 0 for one antenna."""
    level_db = scene.simulation.static_clutter_db
    if scene.environment.receive_antennas == 1 or level_db is None:
        return 0.0
    line = float(harmonics(1, scene.sensors[0].clock_hz * scene.waveform().averaging_s)[0])
    return float(np.degrees(2 * 10 ** (-level_db / 20) / line))


def _presses(scene, index):
    """Groups in which a sensor is steadily touched; None where there are none.

    Returns
    -------
    ndarray, shape (n, 6) or None
        Force, location, changes of both phases against the untouched sensor, and how much of
        these changes is motion of the tag (twice, one for each phase).
    """
    sensor, carrier_hz = scene.sensors[index], scene.radio.center_frequency_hz
    simulation, period_s = scene.simulation, scene.group_period_s
    truth = scene.load_model(simulation.tags[index].truth_model)
    own = [
        [e for e in many if e.sensor == sensor.name]
        for many in (simulation.presses, simulation.moves)
    ]
    pressed = PressedSensor(truth, *own, carrier_hz)
    rows = []
    for press in own[0]:
        end_s = min(press.end_s, simulation.duration_s)
        times = (np.arange(press.start_s // period_s, end_s // period_s + 1) + 0.5) * period_s
        times = times[:: max(1, len(times) * len(own[0]) // _GROUPS)]
        around = pressed.state(np.concatenate([times - period_s, times, times + period_s]))
        steady = around.touch.reshape(3, -1).all(axis=0)
        if not steady.any():
            continue
        times, states = times[steady], pressed.state(times[steady])
        moved = np.broadcast_to(pressed.motion(times), times.shape)
        moved = moved * np.conj(pressed.motion(np.array([press.start_s])))
        motion = np.degrees(np.angle(moved))[:, None]
        change = pressed.mean_phases_deg(times, period_s) - truth.untouched_deg(carrier_hz)
        place = np.stack([states.force_n, states.location_mm], axis=1)
        rows.append(np.hstack([place, change + motion, motion, motion]))
    return np.concatenate(rows) if rows else None


def _span(model):
    """Force and location over what a model was calibrated for; shape (9, 2)."""
    spans = [np.linspace(*span, 3) for span in (model.force_span_n, model.location_span_mm)]
    return np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 2)


def _drawn(model, carrier_hz, points, std):
    """Median errors of phases, force and location where it is known what is pressed."""
    noise = std * np.random.default_rng(0).standard_normal((_DRAWS, len(points), 2))
    phases = points[:, 2:4] + model.untouched_deg(carrier_hz) + noise
    found = model.invert(phases.reshape(-1, 2), std, frequency_hz=carrier_hz)
    force = found.force_n - np.tile(points[:, 0], _DRAWS)
    location = found.location_mm - np.tile(points[:, 1], _DRAWS)
    phase = np.median(np.abs(points[:, 4:6] + noise), axis=(0, 1))
    return tuple(phase.tolist()), _median(force), _median(location)


def _median(error):
    known = np.isfinite(error)
    return float(np.median(np.abs(error[known]))) if known.any() else None


def _claimed(model, carrier_hz, points, std):
    """The same where only the calibration tells what it errs by."""
    untouched = np.array(model.noise_deg(carrier_hz)) / np.sqrt(_UNTOUCHED_SWEEPS)
    spread = _spread(model, carrier_hz, points, np.hypot(std, untouched))
    force, location = MEDIAN * np.median(spread, axis=0)
    return tuple((MEDIAN * std).tolist()), float(force), float(location)


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
    rows = [r for r in rows if same_carrier(r["frequency_mhz"] * 1e6, frequency_hz)]
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
