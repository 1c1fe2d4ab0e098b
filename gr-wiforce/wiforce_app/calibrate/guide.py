# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``gr-wiforce calibrate --live`` needs around its dialogue: options, device, session."""

import functools
import time
from contextlib import ExitStack
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError

from ..shell.options import IntegerRange, optional_radio_options

_LOOK_S = 0.02
_OPTION_OF = {"location_mm": "--locations", "force_n": "--forces", "sweeps": "--sweeps"}


class _Numbers(click.ParamType):
    """Numbers separated by commas."""

    name = "list"

    def convert(self, value, param, ctx):
        if isinstance(value, tuple):
            return value
        try:
            return tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is not a list of numbers such as 20,30,40.", param, ctx)


_OPTIONS = (
    click.option(
        "--live",
        is_flag=True,
        help="Lead through the measurements with a UHD device (docs/first-capture.md).",
    ),
    optional_radio_options,
    click.option("--sensor", help="With --live: the scene's sensor. Default: its only one."),
    click.option(
        "--locations",
        type=_Numbers(),
        help="With --live: mm from port 1. Default: 20,30,40,50,60.",
    ),
    click.option(
        "--forces",
        type=_Numbers(),
        help="With --live: N, at each location. Default: 1,1.5,2,2.5,3,3.5,4,4.5,5,6,7,8.",
    ),
    click.option(
        "--sweeps",
        type=IntegerRange(1, 20),
        default=1,
        show_default=True,
        help="With --live: runs over the forces at each location, rising and falling in turn.",
    ),
    click.option(
        "--scale",
        metavar="SOURCE",
        help="With --live: where forces come from; a CSV file or pipe with a column force_n, or "
        "serial:DEVICE (needs pyserial). Default: typed.",
    ),
    click.option(
        "--scale-unit",
        default="N",
        show_default=True,
        help="Unit of a serial scale whose lines contain none: N, mN, g, kg, lb, oz.",
    ),
    click.option("--baud", type=IntegerRange(1), default=9600, show_default=True),
)


def guided_options(command):
    """Add the options of ``--live``; the command gets them as one argument, ``guided``.

    It is None without ``--live``; then none of them may be given.
    """

    @functools.wraps(command)
    def with_guided(*values, **parameters):
        guided = {name: parameters.pop(name) for name in names}
        if not guided.pop("live"):
            source = click.get_current_context().get_parameter_source
            given = [n for n in guided if source(n) is click.core.ParameterSource.COMMANDLINE]
            if given:
                option = given[0].replace("scene_path", "scene").replace("_", "-")
                raise click.UsageError(f"--{option} needs --live.", click.get_current_context())
            guided = None
        return command(*values, guided=guided, **parameters)

    for option in reversed(_OPTIONS):
        with_guided = option(with_guided)
    before = {parameter.name for parameter in getattr(command, "__click_params__", ())}
    names = [p.name for p in with_guided.__click_params__ if p.name not in before]
    return with_guided


def table_of(table, output, guided):
    """Path of the table: the argument, or with ``--live`` a file beside the output by default."""
    if table is None and guided is None:
        raise click.UsageError("Missing argument 'TABLE'.", click.get_current_context())
    if table is None:
        return str(Path(output).with_suffix(".taps.csv"))
    if guided is not None and Path(table).suffix.lower() != ".csv":
        raise InputError(table, "file of a session must end in .csv")
    return table


def complete_settings(settings, guided):
    """Settings of the calibration with those that have another default with ``--live``."""
    if settings["ruler_std_mm"] is not None:
        return settings
    if guided is None:
        return settings | {"ruler_std_mm": 0.0}
    from gnuradio.wiforce.calibration.guided.session_plan import RULER_STD_MM

    return settings | {"ruler_std_mm": RULER_STD_MM}


def guide(table, guided, settings):
    """Lead a person through the measurements of a sensor.

    Returns float or None: carrier in Hz when the table is to be calibrated; None when the person
    quit before.

    ``table``: file of the session; ``guided``: values of the options of ``--live``; ``settings``:
    arguments of ``sensor.calibrate``.
    """
    from gnuradio.wiforce.calibration.guided.session import CalibrationSession
    from gnuradio.wiforce.calibration.guided.session_plan import SessionPlan
    from gnuradio.wiforce.scene import load_scene

    for name, option in (("scene_path", "--scene"), ("args", "--args")):
        if guided[name] is None:
            raise InputError(option, "must be given with --live")
    guided = dict(guided)
    scene = load_scene(guided.pop("scene_path"))
    sensor = _sensor_named(scene, guided.pop("sensor"))
    own_mm = sensor.load_model(scene).length_mm
    if own_mm != settings["length_mm"]:
        rule = f"must be that of the scene's model '{sensor.model}', {own_mm:g}"
        raise InputError("--length-mm", rule, settings["length_mm"])
    wanted = {"location_mm": guided.pop("locations"), "force_n": guided.pop("forces")}
    try:
        plan = SessionPlan(
            sensor=sensor.name,
            frequency_hz=scene.radio.center_frequency_hz,
            **{key: numbers for key, numbers in wanted.items() if numbers is not None},
            sweeps=guided.pop("sweeps"),
            length_mm=settings["length_mm"],
            permittivity=settings["permittivity"],
        )
    except InputError as error:
        raise error.renamed(_OPTION_OF) from None
    scale = [guided.pop(name) for name in ("scale", "scale_unit", "baud")]
    with CalibrationSession(plan, table, settings) as session, ExitStack() as opened:
        finished = False
        try:
            finished = _measure(session, scene, _open_scale(opened, *scale), **guided)
        finally:
            if not finished and session.presses:
                click.echo(f"\n{_stored(session)}; the same command continues.")
    return plan.frequency_hz if finished else None


def _open_scale(opened, text, unit, baud):
    from .scales import open_scale

    if text is None:
        return None
    scale = open_scale(text, unit, baud)
    opened.callback(scale.close)
    return scale


def _sensor_named(scene, name):
    known = [each.name for each in scene.sensors]
    if name is None and len(known) > 1:
        raise InputError("--sensor", f"must be one of the scene's: {', '.join(known)}")
    for each in scene.sensors:
        if name in (None, each.name):
            return each
    raise InputError("--sensor", f"must be one of the scene's: {', '.join(known)}", name)


def _measure(session, scene, scale, args, **radio):
    """Run the dialogue with a device; whether it came to its end."""
    from ..live.live import radio_request, warn_of_oscillators
    from ..live.radio_keeper import RUNNING, RadioKeeper
    from ..live.session import LiveSession
    from ..radio.request import DeviceLost
    from ..shell.exit_status import FAILED
    from ..shell.log import log
    from .dialogue import GuidedCalibration
    from .live_presses import LivePresses
    from .operator_lines import OperatorLines

    request = radio_request(args, scene, **radio)
    live = LiveSession(scene, request, lambda reading: None)
    keeper = RadioKeeper(request, live, on_open=warn_of_oscillators)
    presses = LivePresses(live, keeper, session.plan.sensor, scene)
    dialogue = GuidedCalibration(session, presses, OperatorLines(), click.echo, scale)
    try:
        while keeper.state != RUNNING:
            presses.idle()
            time.sleep(_LOOK_S)
        return dialogue.run()
    except DeviceLost as lost:
        click.echo()
        log.error(str(lost))
        raise click.exceptions.Exit(FAILED) from lost
    finally:
        keeper.stop()
        live.stop()


def _stored(session):
    return f"presses stored in {session.path}: {len(session.presses)}"
