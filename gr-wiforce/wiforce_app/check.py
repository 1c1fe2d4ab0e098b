# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce check``: what a device and the air give, and what to change before measuring."""

import json
from dataclasses import asdict, dataclass, field

import click
import numpy as np
from gnuradio.wiforce.estimation.frame import MARGIN
from gnuradio.wiforce.estimation.levels import measure_levels
from gnuradio.wiforce.io.samples import samples_of
from gnuradio.wiforce.scene import load_scene

from .live import leave, open_radio, radio_options
from .stream_events import describe_events

_FRAMES = 2000
_SEARCHES = 16
_AFTER_REFERENCE_S = 0.7
_LOOK_S = 0.05


@dataclass
class Sensor:
    """What was heard of one tag; None for what could not be told."""

    name: str
    clock_offset_ppm: float | None = None
    snr_db: list = field(default_factory=list)
    phase_error_deg: list = field(default_factory=list)


@dataclass
class Findings:
    """All that a check finds."""

    hardware: str
    settings: dict
    levels: dict | None = None
    delay_us: float | None = None
    samples_lost: int = 0
    frames_moved: int = 0
    times_ignored: int = 0
    sensors: list = field(default_factory=list)
    advice: list = field(default_factory=list)


@click.command()
@radio_options
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def check(scene_path, args, as_json, amplitude, **radio):
    """Look at levels, noise, delay and the tags' clocks; say what to change before a measurement.

    Nothing may press a sensor meanwhile.
    """
    from .live_session import DeviceLost

    scene = load_scene(scene_path)
    opened = open_radio(args, scene, **radio)
    findings = Findings(opened.hardware, opened.settings())
    try:
        session, samples = _listen(scene, opened, amplitude, args)
    except DeviceLost as lost:
        leave(lost)
    if samples is not None:
        _judge(findings, scene, session, samples)
    findings.advice = advice_on(findings, scene)
    click.echo(json.dumps(asdict(findings), indent=2) if as_json else _text(findings))


def _listen(scene, radio, amplitude, args):
    """A session that has run for the reference and a little more, and the first frames of it."""
    import time

    from gnuradio.wiforce.blocks.sample_keeper import sample_keeper

    from .live_session import LiveSession
    from .watch import Watch

    session = LiveSession(scene, radio, lambda reading: None, amplitude)
    keeper = sample_keeper(_FRAMES * scene.sounding.frame_length)
    session.tap(keeper)
    watch = Watch(session, args, quiet=True)
    session.start()
    wanted_s = scene.reference_s + _AFTER_REFERENCE_S
    while session.time_s < wanted_s and session.alignment.searches < _SEARCHES:
        time.sleep(_LOOK_S)
        watch.look()
    session.stop()
    if session.failure is not None:
        raise session.failure
    if session.alignment.offset is None:
        return session, None
    return session, samples_of(keeper.samples)


def _judge(findings, scene, session, samples):
    waveform = scene.waveform()
    findings.levels = asdict(measure_levels(samples, waveform))
    delay = (session.alignment.offset + MARGIN) % waveform.frame_length
    findings.delay_us = delay / waveform.sample_rate_hz * 1e6
    findings.samples_lost = session.samples_lost
    findings.frames_moved = session.frames_moved
    findings.times_ignored = session.times_ignored
    states = list(session.probe.states)
    for index, sensor in enumerate(scene.sensors):
        findings.sensors.append(_heard(sensor.name, index, states))


def _heard(name, index, states):
    """What the groups tell of one tag, by their medians."""
    locked = [state for state in states if state.clocks[index].locked]
    if not locked:
        return Sensor(name)
    ends = slice(2 * index, 2 * index + 2)
    offsets = [state.clocks[index].offset_ppm for state in locked]
    snr = np.median([state.snr_db[ends] for state in locked], axis=0)
    errors = [state.std_deg[ends] for state in locked if state.std_deg is not None]
    return Sensor(
        name,
        float(np.median(offsets)),
        snr.round(2).tolist(),
        np.median(errors, axis=0).round(3).tolist() if errors else [],
    )


def advice_on(findings, scene):
    """What to change, the most important first; list of str."""
    if findings.levels is None:
        return [
            "no sounding frames heard: look at antennas and cables, raise --tx-gain or --rx-gain"
        ]
    return [
        *_advice_on_levels(findings.levels),
        *_advice_on_loss(findings),
        *(text for sensor in scene.sensors for text in _advice_on_sensor(findings, sensor)),
    ]


def _advice_on_levels(levels):
    peak = levels["peak_dbfs"]
    if levels["clipped"] or peak > -1:
        yield f"the receiver clips or nearly so (peak {peak:.1f} dBFS): lower --rx-gain by 6 dB"
    elif peak < -20:
        more = f"raise --rx-gain by {-6 - peak:.0f} dB"
        yield f"the converter is hardly used (peak {peak:.1f} dBFS): {more}"
    if levels["dc_dbfs"] > -20:
        yield f"a DC offset of {levels['dc_dbfs']:.1f} dBFS takes range: calibrate the device"


def _advice_on_loss(findings):
    help_ = "a faster machine, larger socket buffers or frames"
    if findings.samples_lost:
        yield f"{findings.samples_lost} samples were lost: {help_}"
    for said in describe_events(findings.frames_moved, findings.times_ignored):
        yield f"{said}: {help_}"


def _advice_on_sensor(findings, sensor):
    heard = next(found for found in findings.sensors if found.name == sensor.name)
    if heard.clock_offset_ppm is None:
        yield (
            f"{sensor.name}: no tag heard at {sensor.clock_hz:g} Hz: is it on, near enough, and "
            "does the scene say its clock?"
        )
        return
    if abs(heard.clock_offset_ppm) > 0.8 * sensor.clock_tolerance_ppm:
        yield (
            f"{sensor.name}: its clock is {heard.clock_offset_ppm:+.0f} ppm off: raise "
            "clock_tolerance_ppm in the scene"
        )
    if heard.phase_error_deg and max(heard.phase_error_deg) > 1.5:
        yield (
            f"{sensor.name}: phases will scatter by {max(heard.phase_error_deg):.1f} deg: raise "
            "--tx-gain, bring antennas nearer, or take longer phase groups"
        )


def _text(findings):
    settings = ", ".join(f"{key} {value}" for key, value in findings.settings.items())
    lines = [f"device     {findings.hardware}", f"set to     {settings}"]
    if findings.levels is not None:
        levels = findings.levels
        lines += [
            f"peak       {levels['peak_dbfs']:.1f} dBFS, {100 * levels['clipped']:.3g} % clipped",
            f"preamble   {levels['preamble_dbfs']:.1f} dBFS",
            f"noise      {_or_unknown(levels['noise_dbfs'])} dBFS",
            f"DC offset  {levels['dc_dbfs']:.1f} dBFS",
            f"delay      {findings.delay_us:.2f} us from transmit to receive",
        ]
    lines += [f"{sensor.name:10s} {_sensor_text(sensor)}" for sensor in findings.sensors]
    lines += [f"advice     {text}" for text in findings.advice or ["none: ready to measure"]]
    return "\n".join(lines)


def _sensor_text(sensor):
    if sensor.clock_offset_ppm is None:
        return "not heard"
    snr = " and ".join(f"{value:.1f}" for value in sensor.snr_db)
    text = f"clock {sensor.clock_offset_ppm:+.2f} ppm, SNR {snr} dB"
    if sensor.phase_error_deg:
        errors = " and ".join(f"{value:.2f}" for value in sensor.phase_error_deg)
        text += f", expected phase error {errors} deg per group"
    return text


def _or_unknown(value):
    return "unknown" if value is None else f"{value:.1f}"
