# SPDX-License-Identifier: GPL-3.0-or-later
"""Expected errors of a scene's readings, without simulating any samples.

The noise of the phases follows from the Cramer-Rao bound, the errors of force and location from
passing such phases through the reader's sensor model.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..calibration.validation import contradiction_deg, errors_over_span
from ..scene import Scene
from ..scene.consistency import ONE_ANTENNA, lacks_antenna
from ..sensor import SensorModel
from ..signal.bound import phase_bound_deg
from ..signal.carrier import wrap_deg
from ..signal.switching import harmonics
from ..simulation.channel import PEAK
from ..simulation.paths import NOISE_PEAK
from ..simulation.radio import noise_over_static
from .loss import LONGEST, Snapshots

if TYPE_CHECKING:
    from ..estimation.groups import Array
    from .plan import Plan, PlannedSensor


def _off_error_deg(sensor: PlannedSensor, carrier_hz: float, presses: Array) -> Array:
    """Deviation (n, 2) of both phases at presses (n, 2) by what is unknown of the off states."""
    model, off = sensor.model, sensor.stated.off_reflection
    untouched = np.exp(1j * np.radians(model.untouched_deg(carrier_hz)))
    pressed = np.exp(1j * np.radians(model.phases_deg(presses[:, 0], presses[:, 1], carrier_hz)))
    error = np.abs(1 - (pressed - off) / (untouched - off))
    return np.asarray(np.degrees(sensor.stated.off_reflection_std * error))


# Standard deviation of a noise component, in ADC steps, below which rounding errors are no longer
# like noise, and amplitude of the tag's line, in steps, below which that matters.
_DITHER_STEPS, _FEW_STEPS = 0.3, 10
# Lowest SNR of a tag at which its clock is acquired without fail: -20 dB for the whole of a
# reflection (`bench accuracy`), of which line 1 is 13 dB less.
_LOWEST_SNR_DB = -33.0


@dataclass(frozen=True)
class ReceivedLevels:
    """What reaches the receiver.

    ``noise``, that of the ADC's rounding included, and ``radio`` (around the first tag's line 1,
    that of synthesizers times K) are variances in H over rho^2; ``tag_steps`` and ``noise_steps``
    are in ADC steps.
    """

    noise: float
    radio: float = 0.0
    tag_steps: float = np.inf
    noise_steps: float = np.inf

    @property
    def total(self) -> float:
        """Variance in H of all noise."""
        return self.noise + self.radio

    @property
    def out_of_range(self) -> bool:
        """Whether the tag is lost in the ADC's rounding, whose error is then systematic."""
        return self.noise_steps < _DITHER_STEPS and self.tag_steps < _FEW_STEPS


def line_amplitude(scene: Scene) -> float:
    """Amplitude c1[1] of the first tag's line +1, in units of rho."""
    return float(harmonics(1, scene.sensors[0].clock_hz * scene.waveform().averaging_s)[0])


def receive_levels(scene: Scene) -> ReceivedLevels:
    """Levels at the receiver with the simulated peak."""
    simulation, waveform = scene.simulation, scene.waveform()
    line = line_amplitude(scene)
    noise = line**2 / 10 ** (simulation.snr_db / 10)
    if scene.packets is not None:
        # Channels are given; how their device rounds is part of what snr_db states.
        return ReceivedLevels(noise)
    sample_std = np.sqrt(noise / waveform.channel_noise_gain / 2)
    static_db = simulation.static_clutter_db
    clutter = [static_db, simulation.moving_clutter_db]
    amplitudes = [line * 10 ** (db / 20) for db in clutter if db is not None]
    amplitudes += [10 ** (tag.level_db / 20) for tag in simulation.tags]
    peak = sum(amplitudes) * float(np.abs(waveform.frame()).max()) + NOISE_PEAK * sample_std
    step = peak / PEAK / 2 ** ((simulation.adc_bits or 16) - 1)
    noise += 2 * step**2 / 12 * waveform.channel_noise_gain
    radio, stated = 0.0, simulation.radio_noise
    if stated is not None and static_db is not None:
        alike, independent = noise_over_static(stated, waveform, scene.sensors[0].clock_hz)
        # Two antennas have the same phase noise, which cancels in their ratio.
        alike *= scene.environment.receive_antennas == 1
        radio = line**2 * 10 ** (static_db / 10) * (len(waveform.bins) * alike + independent)
    return ReceivedLevels(float(noise), float(radio), line / step, float(sample_std / step))


def why_not_readable(scene: Scene, index: int, levels: ReceivedLevels) -> str | None:
    """Why a sensor of a simulated scene cannot be read; None when it can."""
    tag = scene.simulation.tags[index]
    if levels.out_of_range:
        return (
            f"ADC range: beside the static path the tag's line has {levels.tag_steps:.2g} steps "
            f"and noise {levels.noise_steps:.2g}; rounding errors are systematic, the tag is out "
            "of the ADC's range"
        )
    snr_db = 10 * np.log10(line_amplitude(scene) ** 2 / levels.total) + tag.level_db
    if scene.packets is None and snr_db < _LOWEST_SNR_DB:
        return (
            f"SNR: with all noise that of '{tag.sensor}' is {snr_db:.0f} dB; below "
            f"{_LOWEST_SNR_DB:g} dB its clock is not acquired"
        )
    if lacks_antenna(scene):
        return ONE_ANTENNA
    if tag.clock2_duty != "pulses":
        return (
            f"both switches of '{tag.sensor}' are on at the same time "
            f"(clock2_duty: {tag.clock2_duty}): its ends cannot be separated"
        )
    return None


# Median of |x| for a Gaussian x of unit standard deviation.
MEDIAN = 0.6745
# Sweeps over which a calibration is assumed to average the untouched phases.
_UNTOUCHED_SWEEPS = 10
# Of the phases of a radio without noise, where a variance is divided by.
_NOISELESS_DEG = 1e-6

# What limits the force, as Expected.limited_by.
RADIO, CALIBRATION = "radio", "calibration"
OFF_STATES, ANTENNAS = "off states", "two antennas"
_LIMITS = {
    RADIO: "noise of the radio",
    CALIBRATION: "calibration",
    OFF_STATES: "off_reflection_std",
    ANTENNAS: "ratio of two antennas, which is not linear",
}


@dataclass(frozen=True)
class Expected:
    """Expected errors of one sensor; None where it is not readable.

    Errors are medians over the calibrated span, by noise and the errors that the calibration
    states, while only what presses moves.
    """

    sensor: str
    phase_std_deg: tuple[float, ...]  # by noise, of a reading while nothing changes
    phase_error_deg: tuple[float, ...] | None = None  # of changes against the untouched sensor
    force_error_n: float | None = None
    location_error_mm: float | None = None
    # What causes most of the variance of the force.
    limited_by: str | None = None
    flagged: float | None = None  # share of the calibrated span in which readings are flagged

    def __str__(self) -> str:
        error, std = self.phase_error_deg, self.phase_std_deg
        if error is None or self.limited_by is None:
            return f"{self.sensor}: not readable"
        text = f"{self.sensor}: force {self.force_error_n:.3g} N and location "
        text += f"{self.location_error_mm:.3g} mm over the calibrated span"
        if self.flagged:
            text += f" without the {self.flagged:.0%} where readings are flagged"
        return (
            f"{text}, limited by the {_LIMITS[self.limited_by]}; phase errors {error[0]:.3g} deg "
            f"at port 1 and {error[1]:.3g} deg at port 2 (standard deviations of their noise "
            f"{std[0]:.3g} and {std[1]:.3g} deg)"
        )


def expect(plan: Plan) -> tuple[Expected, ...]:
    """Expected errors of every sensor of a plan, by the ``simulation`` of its scene."""
    scene, carrier_hz = plan.require_scene(), plan.center_frequency_hz
    levels = receive_levels(scene)
    found = []
    for i, (sensor, noise) in enumerate(zip(plan.sensors, phase_std_deg(plan), strict=True)):
        own = Expected(sensor.name, tuple(noise.tolist()))
        if not why_not_readable(scene, i, levels):
            model = sensor.model
            off = np.sqrt(np.mean(_off_error_deg(sensor, carrier_hz, _span(model)) ** 2, axis=0))
            stds = {RADIO: noise, OFF_STATES: off, ANTENNAS: np.full(2, _curvature_deg(scene))}
            std = _together(stds.values())
            untouched = np.array(model.noise_deg(carrier_hz)) / np.sqrt(_UNTOUCHED_SWEEPS)
            force, location, flagged = errors_over_span(model, carrier_hz, np.hypot(std, untouched))
            own = replace(
                own,
                phase_error_deg=tuple((MEDIAN * std).tolist()),
                force_error_n=MEDIAN * force,
                location_error_mm=MEDIAN * location,
                limited_by=_limit(model, carrier_hz, stds),
                flagged=flagged,
            )
        found.append(own)
    return tuple(found)


def _together(stds: Iterable[np.ndarray]) -> np.ndarray:
    """Standard deviations (2,) of the sum of independent errors."""
    return np.asarray(np.sqrt(sum((std**2 for std in stds), np.full(2, _NOISELESS_DEG**2))))


def _limit(model: SensorModel, carrier_hz: float, stds: dict[str, np.ndarray]) -> str:
    """What most of the variance of the force comes from, by phases (2,) of each cause."""

    def variance(causes: Iterable[str]) -> np.ndarray:
        std = _together(stds[cause] for cause in causes)
        return _spread(model, carrier_hz, _span(model), std)[:, 0] ** 2

    whole = variance(stds)
    shares = {cause: np.median(1 - variance(stds.keys() - {cause}) / whole) for cause in stds}
    shares[CALIBRATION] = np.median(variance(()) / whole)
    return max(shares, key=lambda cause: shares[cause])


def error_map(plan: Plan, sensor: int, force_n: np.ndarray, location_mm: np.ndarray) -> np.ndarray:
    """Expected deviations (F, L, 2), in N and mm, over force (F,) and location (L,)."""
    planned, carrier_hz = plan.sensors[sensor], plan.center_frequency_hz
    grid = np.meshgrid(force_n, location_mm, indexing="ij")
    points = np.stack(grid, axis=-1).reshape(-1, 2)
    std = np.hypot(phase_std_deg(plan)[sensor], _off_error_deg(planned, carrier_hz, points))
    spread = _spread(planned.model, carrier_hz, points, std)
    return spread.reshape(len(force_n), len(location_mm), 2)


# Readings are flagged `inconsistent` beyond so many standard deviations (docs/sensors.md, flags).
_UNEXPLAINED_STDS = 3.0


def other_sensors_pressed(plan: Plan) -> Iterator[str]:
    """Sensors, but strips, whose calibration does not explain what is pressed; sentences."""
    scene, carrier_hz = plan.require_scene(), plan.center_frequency_hz
    if scene.surface is not None:
        return
    for sensor, tag, noise_deg in zip(
        plan.sensors, scene.simulation.tags, phase_std_deg(plan), strict=True
    ):
        model, truth = sensor.model, scene.load_model(tag.truth_model)
        force_n, location_mm = _span(model).T
        pressed = _changes(truth, force_n, location_mm, carrier_hz)
        apart = wrap_deg(pressed - _changes(model, force_n, location_mm, carrier_hz))
        std = model.model_std_deg(force_n, location_mm, carrier_hz)
        if _rms(apart / np.hypot(std, noise_deg)) > _UNEXPLAINED_STDS:
            yield (
                f"simulation.truth_model {tag.truth_model} is another sensor than the model of "
                f"'{sensor.name}': over the calibrated span their phases differ by "
                f"{_rms(apart):.2g} deg, where the calibration states {_rms(std):.2g}; readings "
                "will be wrong or flagged (remove truth_model if this is not meant)"
            )


def _changes(
    model: SensorModel, force_n: np.ndarray, location_mm: np.ndarray, carrier_hz: float
) -> np.ndarray:
    """Phases (n, 2) of presses against the untouched sensor, in degrees."""
    phases = model.phases_deg(force_n, location_mm, carrier_hz)
    return phases - model.untouched_deg(carrier_hz)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def phase_std_deg(plan: Plan) -> np.ndarray:
    """Noise of the phases alone as ``Expected.phase_std_deg`` of every sensor, (S, 2).

    From the bound of arg R to psi, whose slope is |D| / |G| on average over the calibrated span.
    """
    scene, waveform = plan.require_scene(), plan.waveform
    # Beyond that length the variance falls with it.
    snapshots = Snapshots.of(plan, LONGEST)
    sizes = []
    for sensor in plan.sensors:
        force_n, location_mm = _span(sensor.model).T
        phases = sensor.model.phases_deg(force_n, location_mm, plan.center_frequency_hz)
        switched = np.exp(1j * np.radians(phases)) - sensor.stated.off_reflection
        sizes.append(np.sqrt(np.mean(np.abs(switched) ** 2, axis=0)))
    amplitudes = 10 ** (np.array([[tag.level_db] for tag in scene.simulation.tags]) / 20) * sizes
    subcarriers = len(waveform.bins)
    bound = phase_bound_deg(
        np.repeat(amplitudes.reshape(-1, 1).astype(complex), subcarriers, axis=1),
        np.full(subcarriers, receive_levels(scene).total),
        [(hz, 1.0 + 2.4 * i) for i, hz in enumerate(plan.clocks_hz)],
        snapshots.times_s,
        waveform.averaging_s,
        clutter=snapshots.clutter,
    )
    groups = plan.group_length / len(snapshots.times_s)
    share = 1 / plan.smoothing_groups + 1 / plan.reference_groups
    loss = 10 ** (np.array(plan.loss_db) / 10) if plan.loss_db else 1.0
    std = bound * np.sqrt(loss * share / groups)
    return np.asarray(std.reshape(-1, 2) * sizes)


def _curvature_deg(scene: Scene) -> float:
    """Phase error of a ratio of antennas: |T| / |S| in reference and reading; 0 for one.

    That of packets is solved for (docs/wifi.md).
    """
    level_db = scene.simulation.static_clutter_db
    if scene.environment.receive_antennas == 1 or scene.packets or level_db is None:
        return 0.0
    return float(np.degrees(2 * 10 ** (-level_db / 20) / line_amplitude(scene)))


def _span(model: SensorModel) -> np.ndarray:
    """Force and location over a model's calibrated span; shape (9, 2)."""
    forces, locations = (
        np.linspace(low, high, 3) for low, high in (model.force_span_n, model.location_span_mm)
    )
    return np.stack(np.meshgrid(forces, locations, indexing="ij"), axis=-1).reshape(-1, 2)


def _spread(
    model: SensorModel, frequency_hz: float, points: np.ndarray, phase_std_deg: np.ndarray
) -> np.ndarray:
    """Standard deviations of force and location at each press; shape (n, 2)."""
    variance = phase_std_deg**2 + model.model_std_deg(points[:, 0], points[:, 1], frequency_hz) ** 2
    variance += contradiction_deg(model, frequency_hz, points[:, 1]) ** 2
    covariance = model.inverter(frequency_hz).covariance(points[:, 0], points[:, 1], variance)
    return np.sqrt(np.einsum("naa->na", covariance))
