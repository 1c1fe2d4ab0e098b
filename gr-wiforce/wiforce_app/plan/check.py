# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce check`` of a device: levels, delay, tag clocks, advice; files by `check_file`."""

import json
from dataclasses import asdict, dataclass, field

import click
from gnuradio.wiforce.estimation.capture.frame import MARGIN, describe_frames, measure_levels
from gnuradio.wiforce.io.capture.samples import samples_of
from gnuradio.wiforce.planning.advice import licence_note, outside_band
from gnuradio.wiforce.planning.findings import measure_tags, wrong_clocks
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.schema import Scene

from ..live.live import radio_request
from ..radio.request import DRIVERS, DeviceLost
from ..read.recordings import describe_events
from ..shell.interrupts import FAILED
from ..shell.log import log
from ..shell.options import csi_file, csi_options, optional_radio_options, sample_type
from .check_file import (
    LEVEL_FRAMES,
    advice_on_levels,
    advice_on_sensors,
    check_file,
    labelled,
    level_lines,
)

_SEARCHES = 16
_AFTER_REFERENCE_S = 0.7
_LOOK_S = 0.05


@dataclass
class Findings:
    hardware: str
    settings: dict
    levels: dict | None = None
    delay_us: float | None = None
    samples_lost: int = 0
    frames_moved: int = 0
    times_ignored: int = 0
    sensors: list = field(default_factory=list)
    room: list = field(default_factory=list)
    wrong_clocks: dict = field(default_factory=dict)  # what is wrong with a sensor's clock_hz
    advice: list = field(default_factory=list)
    notes: list = field(default_factory=list)


@click.command()
@click.argument("file", type=click.Path(), required=False)
@optional_radio_options
@sample_type
@csi_options
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def check(file, scene_path, args, datatype, csi_tool, mac, second_antenna, as_json, **radio):
    """Measure levels, noise, delay and the tags' clocks, and advise what to change.

    With --args and --scene the check receives from a device; no sensor may be pressed meanwhile.
    With a FILE instead it says what the file is, whether a tag is seen in it, and what to change
    first: channel snapshots (.npz, or a file of a CSI tool) and captures of samples. Where the
    scene of a capture is known, checksum, length, gaps, frames and levels are verified.

    The exit status is 0 also where no frames or no tag are found: see the advice.
    """
    csi = csi_file(csi_tool, mac, second_antenna)
    if file is not None:
        if args is not None:
            raise click.UsageError("FILE and --args exclude each other")
        found, text = check_file(file, scene_path, datatype, csi)
        click.echo(json.dumps(found, indent=2) if as_json else text)
        return 0
    if datatype is not None or csi is not None:
        option = "--csi-tool" if datatype is None else "--datatype"
        raise click.UsageError(f"{option} is that of a recording: give a FILE as well")
    if args is None or scene_path is None:
        raise click.UsageError("give --scene and --args for a device, or a FILE")
    scene = load_scene(scene_path)
    request = radio_request(args, scene, **radio)
    try:
        link, session, samples = _receive(scene, request)
    except DeviceLost as lost:
        log.error(str(lost))
        return FAILED
    findings = Findings(link.hardware, link.settings)
    if samples is not None:
        _measure(findings, scene, session, samples)
    findings.advice = advice_on(findings, scene)
    findings.notes = list(licence_note(scene))
    if DRIVERS[request.driver].delay_differs and findings.delay_us is not None:
        findings.notes.append("the delay differs from start to start with this driver")
    if as_json:
        values = {**asdict(findings), "room": [found.row() for found in findings.room]}
        click.echo(json.dumps(values, indent=2))
    else:
        click.echo(_text(findings))
    return 0


def _receive(scene, request):
    """The device, a session that has run a little longer than the reference, its first frames."""
    import time

    from gnuradio.wiforce.blocks.sample_files import sample_keeper

    from ..live.radio_keeper import RadioKeeper, warn_of_oscillators
    from ..live.session import LiveSession

    session = LiveSession(scene, request, lambda reading: None)
    keeper = sample_keeper(LEVEL_FRAMES * scene.sounding.frame_length)
    session.tap(keeper)
    links = []
    radio = RadioKeeper(request, session, on_open=links.append)
    wanted_s = scene.reference_s + _AFTER_REFERENCE_S
    try:
        while session.time_s < wanted_s and session.alignment.searches < _SEARCHES:
            time.sleep(_LOOK_S)
            radio.look()
    finally:
        radio.stop()
        session.stop()
    warn_of_oscillators(links[0])
    if session.reader.failure is not None:
        raise session.reader.failure
    if session.alignment.offset is None:
        return links[0], session, None
    return links[0], session, samples_of(keeper.samples)


def _measure(findings, scene, session, samples):
    waveform = scene.waveform()
    findings.levels = asdict(measure_levels(samples, waveform))
    delay = (session.alignment.offset + MARGIN) % waveform.frame_length
    findings.delay_us = delay / waveform.sample_rate_hz * 1e6
    findings.samples_lost = session.fold.samples_lost()
    findings.frames_moved = session.fold.frames_moved()
    findings.times_ignored = session.fold.times_ignored()
    settings = plan(scene)
    findings.sensors = measure_tags(settings, session.latest)
    findings.room = session.reader.findings or []
    findings.wrong_clocks = wrong_clocks(session.reader.stream.survey, settings)


def advice_on(findings: Findings, scene: Scene) -> list[str]:
    """What to change before a measurement, the most important first."""
    if findings.levels is None:
        return [
            *outside_band(scene),
            f"no sounding frames found ({describe_frames(scene.waveform())}): check antennas and "
            "cables, raise --tx-gain or --rx-gain",
        ]
    others_hz = [found.frequency_hz for found in findings.room if found.kind == "tag"]
    return [
        *outside_band(scene),
        *advice_on_levels(findings.levels),
        *_advice_on_loss(findings),
        *advice_on_sensors(findings.sensors, scene, others_hz, findings.wrong_clocks),
    ]


def _advice_on_loss(findings):
    remedy = "use a faster machine, larger socket buffers or larger frames"
    if findings.samples_lost:
        yield f"{findings.samples_lost} samples were lost: {remedy}"
    for event in describe_events(findings.frames_moved, findings.times_ignored):
        yield f"{event}: {remedy}"


def _text(findings):
    settings = ", ".join(f"{key} {value}" for key, value in findings.settings.items())
    lines = [("device", findings.hardware), ("set to", settings)]
    if findings.levels is not None:
        lines += level_lines(findings.levels)
        lines.append(("delay", f"{findings.delay_us:.2f} us from transmit to receive"))
    lines += [(sensor.name, sensor) for sensor in findings.sensors]
    lines += [("room", finding.line) for finding in findings.room]
    advice = findings.advice or ["none, ready to measure"]
    return labelled(lines, {"advice": advice, "notes": findings.notes})
