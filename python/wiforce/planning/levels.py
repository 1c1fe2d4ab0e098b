# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of a simulated scene at the receiver: noise, the ADC's steps, and what they hide."""

from dataclasses import dataclass

import numpy as np

from ..scene import Scene
from ..signal.switching import harmonics
from ..simulation.channel import PEAK
from ..simulation.levels import NOISE_PEAK
from ..simulation.radio.synthesizers import noise_over_static

# Standard deviation of a noise component, in ADC steps, below which rounding errors are no longer
# like noise, and amplitude of the tag's line, in steps, below which that matters.
_DITHER_STEPS, _FEW_STEPS = 0.3, 10
# Lowest SNR of a tag at which its clock is acquired without fail: -20 dB for the whole of a
# reflection (`bench accuracy`), of which line 1 is 13 dB less.
_LOWEST_SNR_DB = -33.0


@dataclass(frozen=True)
class ReceivedLevels:
    """What reaches the receiver.

    Attributes
    ----------
    noise, quantisation, radio : float
        Variance in H, in units of a tag's rho^2, of the noise that the scene's ``snr_db`` states,
        of the ADC's rounding, and of the radio around the first tag's line 1; per subcarrier and
        snapshot. That of synthesizers is alike on all K subcarriers and counts K times.
    tag_steps : float
        Amplitude of the first tag's line +1, in ADC steps.
    noise_steps : float
        Standard deviation of a component of a sample's noise, in ADC steps.
    """

    noise: float
    quantisation: float
    radio: float
    tag_steps: float
    noise_steps: float

    @property
    def out_of_range(self) -> bool:
        """Whether the tag is lost in the ADC's rounding, whose error is then systematic."""
        return self.noise_steps < _DITHER_STEPS and self.tag_steps < _FEW_STEPS


def line_amplitude(scene: Scene) -> float:
    """Amplitude c1[1] of the first tag's line +1, in units of rho."""
    return float(harmonics(1, scene.sensors[0].clock_hz * scene.waveform().averaging_s)[0])


def receive_levels(scene: Scene) -> ReceivedLevels:
    """Levels at the receiver when the signal's peak is as far below full scale as simulated."""
    simulation, waveform = scene.simulation, scene.waveform()
    line = line_amplitude(scene)
    noise = line**2 / 10 ** (simulation.snr_db / 10)
    if scene.packets is not None:
        # Channels are given; how their device rounds is part of what snr_db states.
        return ReceivedLevels(noise, 0.0, 0.0, np.inf, np.inf)
    sample_std = np.sqrt(noise / waveform.channel_noise_gain / 2)
    clutter = [simulation.static_clutter_db, simulation.moving_clutter_db]
    amplitudes = [line * 10 ** (db / 20) for db in clutter if db is not None]
    amplitudes += [10 ** (tag.level_db / 20) for tag in simulation.tags]
    peak = sum(amplitudes) * float(np.abs(waveform.frame()).max()) + NOISE_PEAK * sample_std
    step = peak / PEAK / 2 ** ((simulation.adc_bits or 16) - 1)
    quantisation = 2 * step**2 / 12 * waveform.channel_noise_gain
    static_db = simulation.static_clutter_db
    static = 0.0 if static_db is None else line**2 * 10 ** (static_db / 10)
    return ReceivedLevels(
        noise,
        float(quantisation),
        float(static * radio_noise_share(scene)),
        float(line / step),
        float(sample_std / step),
    )


def radio_noise_share(scene: Scene, carrier_hz: float | None = None) -> float:
    """Variance in H of the radio's noise over the power of the static path.

    At another carrier than the scene's, the same reference is multiplied by another factor: phase
    noise grows with its square.
    """
    stated, waveform = scene.simulation.radio_noise, scene.waveform()
    if stated is None:
        return 0.0
    alike, independent = noise_over_static(stated, waveform, scene.sensors[0].clock_hz)
    # Two antennas have the same phase noise, which cancels in their ratio.
    alike *= scene.environment.receive_antennas == 1
    if carrier_hz is not None:
        alike *= (carrier_hz / scene.radio.center_frequency_hz) ** 2
    return len(waveform.bins) * alike + independent


def why_not_readable(scene: Scene, index: int, levels: ReceivedLevels | None = None) -> str | None:
    """Why a sensor of a simulated scene cannot be read.

    Returns str or None: None when it can be read.

    Parameters
    ----------
    index : int
        Of the sensor.
    levels : ReceivedLevels, optional
        Those of the scene, when they are known already.
    """
    tag, levels = scene.simulation.tags[index], levels or receive_levels(scene)
    if levels.out_of_range:
        return (
            f"ADC range: beside the static path the tag's line has {levels.tag_steps:.2g} steps "
            f"and noise {levels.noise_steps:.2g}; rounding errors are systematic, the tag is out "
            "of the ADC's range"
        )
    noise = levels.noise + levels.quantisation + levels.radio
    snr_db = 10 * np.log10(line_amplitude(scene) ** 2 / noise) + tag.level_db
    if scene.packets is None and snr_db < _LOWEST_SNR_DB:
        return (
            f"SNR: with all noise that of '{tag.sensor}' is {snr_db:.0f} dB; below "
            f"{_LOWEST_SNR_DB:g} dB its clock is not acquired"
        )
    if scene.environment.reader_clock == "free" and scene.environment.receive_antennas == 1:
        return (
            "reader_clock free: with one receive antenna, the common phase of transmitter and "
            "receiver is indistinguishable from the tag in quadrature with the direct path"
        )
    if tag.clock2_duty != "pulses":
        return (
            f"both switches of '{tag.sensor}' are on at the same time "
            f"(clock2_duty: {tag.clock2_duty}): its ends cannot be separated"
        )
    return None
