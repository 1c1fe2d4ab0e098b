# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce calibrate`` and ``transfer``: known presses to sensor models, with their errors."""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce import sensor
from gnuradio.wiforce.calibration.gauges import UNITS
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.palette import FAINT, series_style
from gnuradio.wiforce.io.text.textfile import check_output
from gnuradio.wiforce.sensor.curves import FORMS
from gnuradio.wiforce.signal.carrier import CARRIERS_HZ, same_carrier, wrap_deg

from ..shell.commands import GroupedHelp
from ..shell.options import (
    CARRIER_HZ,
    FiniteRange,
    IntegerRange,
    Number,
    optional_radio_options,
    sensor_names,
    sensor_output,
)
from ..shell.plots import check_picture, save_picture
from .guide import check_guided, guide, table_of

# Parameters of the library that options set.
_SETTINGS = "length_mm permittivity form onset_force_n location_steps mirror ruler_std_mm".split()
_POINTS = 80  # of a curve in a picture


def _numbers(context, parameter, value):
    """Numbers separated by commas."""
    try:
        return None if value is None else tuple(map(float, value.split(",")))
    except ValueError:
        rule = f"{value!r} is not a list of numbers such as 20,30,40."
        raise click.BadParameter(rule) from None


@click.command(
    cls=GroupedHelp,
    groups={
        "Options": "--output --frequency-hz --kind --refine --plot --accept --live --surface",
        "Curves": "--name --length-mm --permittivity --form --onset-force-n --location-steps "
        "--mirror --ruler-std-mm",
        "With --surface": "--readings --law",
        "With --live": "--scene --sensor --locations --forces --sweeps --scale --scale-unit --baud",
        "Radio": "--args --driver --tx-args --receive-only --tx-gain --rx-gain --antenna "
        "--tx-antenna --bandwidth --reference --amplitude",
    },
    examples=(
        "calibrate vna.csv -o arm.yaml --plot arm.png",
        "calibrate --live --scene arm.yaml --args type=b200 -o new.yaml",
    ),
)
@click.argument("table", type=click.Path(), required=False)
@sensor_output
@click.option(
    "--frequency-hz", type=FiniteRange(*CARRIERS_HZ), help="Carrier, where the file does not say."
)
@click.option(
    "--kind",
    type=click.Choice(["vna", "touchstone", "taps"]),
    help="What TABLE is; by its columns when not given.",
)
@click.option("--name", help="Name of the sensor; the output's name by default.")
@click.option("--length-mm", type=Number(), default=80.0)
@click.option(
    "--permittivity",
    type=Number(),
    default=1.0,
    help="Effective relative permittivity of the line.",
)
@click.option(
    "--form",
    type=click.Choice(("auto", "auto-beyond", *FORMS)),
    default="auto",
    help="Curves of force; auto: by cross-validation, auto-beyond: outside the forces too.",
)
@click.option("--onset-force-n", type=Number(), help="Force at which the line is first shorted.")
@click.option(
    "--location-steps",
    type=click.Choice(["nearest", "given", "line"]),
    default="nearest",
    help="Phases from one location to the next: as measured, turns of 360 deg by the line; as "
    "given; or those of the line, only the movement with force measured.",
)
@click.option(
    "--mirror", is_flag=True, help="Take absent locations from the other half, ports swapped."
)
@click.option(
    "--ruler-std-mm",
    type=FiniteRange(0),
    help="Standard deviation of the locations. Default: 0, with --live 0.3.",
)
@click.option(
    "--refine",
    "refined",
    metavar="SENSOR",
    shell_complete=sensor_names,
    help="Refine this sensor with TABLE instead.",
)
@click.option("--plot", "plot_path", type=click.Path(), help="Picture of data and curves, PNG.")
@click.option(
    "--accept",
    is_flag=True,
    help="Write the file although TABLE seems to have a mistake; it states the mistake.",
)
@click.option(
    "--surface",
    metavar="SCENE",
    help="Calibrate how the skin of this scene's surface spreads presses, instead of a sensor.",
)
@click.option(
    "--readings",
    type=click.Path(),
    help="With --surface: what `read` gave for the presses of TABLE.",
)
@click.option(
    "--law",
    type=click.Choice(["strips", "table", "gaussian"]),
    help="With --surface: form of the spreading law; strips: a table for each. Default: strips.",
)
@click.option(
    "--live",
    is_flag=True,
    help="Lead through the measurements with a UHD device (docs/sensors.md).",
)
@optional_radio_options
@click.option("--sensor", help="With --live: the scene's sensor. Default: its only one.")
@click.option(
    "--locations",
    callback=_numbers,
    metavar="LIST",
    help="With --live: mm from port 1. Default: 20,30,40,50,60.",
)
@click.option(
    "--forces",
    callback=_numbers,
    metavar="LIST",
    help="With --live: N, at each location. Default: 1,1.5,2,2.5,3,3.5,4,4.5,5,6,7,8.",
)
@click.option(
    "--sweeps",
    type=IntegerRange(1, 20),
    default=1,
    help="With --live: runs over the forces at each location, rising and falling in turn.",
)
@click.option(
    "--scale",
    metavar="SOURCE",
    help="With --live: where forces come from; a CSV file or pipe with a column force_n, or "
    "serial:DEVICE (needs pyserial). Default: typed.",
)
@click.option(
    "--scale-unit",
    default="N",
    help=f"Unit of a serial scale whose lines contain none: {UNITS}.",
)
@click.option("--baud", type=IntegerRange(1), default=9600)
def calibrate(
    table,
    output,
    frequency_hz,
    kind,
    name,
    refined,
    plot_path,
    accept,
    surface,
    readings,
    law,
    live,
    **guided,
):
    """Make a sensor model of a TABLE of known presses.

    TABLE is a VNA's CSV (freq_mhz, location_mm, port, force_n, phase_deg; rows with force 0 and no
    location are the untouched sensor), an index CSV of Touchstone files (file, force_n,
    location_mm), or taps read over the air (phase1_deg, phase2_deg, force_n, location_mm). A column
    press or trial distinguishes presses at one location.

    With --live, a person with a ruler and a force gauge is led through the measurements at a UHD
    device. They are stored in TABLE (SENSOR.taps.csv) at once; the same command continues after
    an interruption.

    With --surface, TABLE lists presses on the skin of a surface (start_s, end_s, force_n, x_mm,
    y_mm), and the spreading law is written to OUTPUT.
    """
    from gnuradio.wiforce.calibration.data import without_incomplete
    from gnuradio.wiforce.calibration.session import RULER_STD_MM

    settings = {key: guided.pop(key) for key in _SETTINGS}
    check_guided(live, guided)
    if surface is None and (readings, law) != (None, None):
        raise InputError("--readings" if readings else "--law", "is for --surface only")
    if surface is not None:
        from .surface import calibrate_surface

        others = {"--live": live, "--refine": refined, "--plot": plot_path, "--kind": kind}
        for option, value in others.items():
            if value:
                raise InputError(option, "cannot be given with --surface")
        return calibrate_surface(table, surface, readings, law or "strips", output, accept)
    table = table_of(table, output, live)
    if settings["ruler_std_mm"] is None:
        settings["ruler_std_mm"] = RULER_STD_MM if live else 0.0
    inputs = [table, *([refined] if refined else [])]
    check_output(output, inputs)
    check_picture(plot_path, inputs)
    name = name or Path(output).stem
    if live:
        if (frequency_hz, kind) != (None, None):
            raise InputError("--live", "must be given without --frequency-hz and --kind")
        frequency_hz, kind = guide(table, guided, settings), "taps"
        if frequency_hz is None:
            return
    data = _read(table, kind, frequency_hz)
    data = without_incomplete(data) if live else data
    bench = None if refined is None else sensor.load_sensor(refined, frequency_hz=frequency_hz)
    try:
        if bench is None:
            model = sensor.calibrate(data, name, **settings)
        else:
            model = sensor.refine(bench, data, name)
        verdicts = sensor.verdict(model)  # refuses a model that cannot be inverted
    except InputError as error:
        # With the mistake in the table that may be its cause.
        line = settings if bench is None else vars(bench)
        found = sensor.suspicions(data, line["length_mm"], line["permittivity"])
        where = error.where
        if where in (*_SETTINGS, "name"):
            where = f"--{where.replace('_', '-')}"
        elif where.startswith("sensor"):  # a model that is in no file
            where = f"{table}: {where}"
        raise InputError(where, "; ".join([error.rule, *found])) from None
    suspected = model.provenance.get("suspicions", [])
    if bench is None and (assumed := sensor.untouched_assumed(data, model.length_mm)):
        suspected = [*assumed, *suspected]
        model = replace(model, provenance=model.provenance | {"suspicions": suspected})
    if suspected and not accept:
        rule = "correct it, or write the sensor nevertheless with --accept"
        raise InputError(table, f"{'; '.join(suspected)} ({rule})")
    sensor.write_sensor(model, output)
    for text in [*_verdict(model, verdicts, suspected), *_report(model)]:
        click.echo(text)
    if plot_path is not None:
        plot_calibration(data, model, plot_path)
    click.echo(f"written: {output}")


def _verdict(model, verdicts, suspected):
    """What the sensor is good for and what speaks against it, first of all."""
    for text in suspected:
        yield f"not to be trusted: {text}"
    for found in verdicts:
        at = f" at {found.frequency_hz / 1e6:g} MHz" if len(model.carriers) > 1 else ""
        yield f"verdict{at}, as standard deviations without the noise of a radio:"
        if found.unusable:
            yield f"  {found.unusable}"
        for (std, most), unit in ((found.force_std_n, "N"), (found.location_std_mm, "mm")):
            yield f"  {std:.2g} {unit} (at most {most:.2g})"
        if 0 < found.flagged < 1:
            flags = f"flagged {' or '.join(found.flags)}" if found.flags else "empty"
            yield (
                f"  left out: {found.flagged:.0%} of the span, where readings are {flags} (what to "
                "do: docs/sensors.md, Flags)"
            )
    if not model.ruler_std_mm:
        yield "  locations are taken as exact: a wrong ruler shifts readings (see --ruler-std-mm)"
    yield from (f"warning: {warning}" for warning in sensor.calibration_warnings(model))
    yield ""


def _read(table, stated_kind, frequency_hz):
    kind = stated_kind or sensor.table_kind(table)
    if kind == "vna":
        return sensor.read_vna_csv(table, frequency_hz)
    if frequency_hz is None:
        rule = f"is missing: {table} does not state its carrier; give it, as 915e6"
        raise InputError("--frequency-hz", rule)
    reader = {"touchstone": sensor.read_touchstone_index, "taps": sensor.read_tap_csv}[kind]
    return reader(table, frequency_hz)


def _report(model):
    """Lines that say what a calibrated model holds and how far it can be trusted."""
    yield (
        f"sensor {model.name}: {model.form} curves of force, first shorted at "
        f"{model.onset_force_n:.3g} N"
    )
    (least_n, most_n), (first_mm, last_mm) = model.force_span_n, model.location_span_mm
    yield f"calibrated {least_n:g}..{most_n:g} N, {first_mm:g}..{last_mm:g} mm"
    for carrier in model.carriers:
        places = ", ".join(f"{location:g}" for location in carrier.location_mm)
        noise, misfit = (
            " / ".join(f"{value:.2f}" for value in both)
            for both in (carrier.noise_deg, carrier.misfit_deg)
        )
        yield f"\n{carrier.frequency_hz / 1e6:g} MHz, locations {places} mm"
        yield f"  noise of the phases {noise} deg, misfit of the curves {misfit} deg (port 1 / 2)"
        half_n = carrier.hysteresis_n
        if half_n is not None:
            yield f"  loading and unloading differ by up to {2 * half_n:.2f} N at the same phases"
    if validation := model.cross_validation:
        forms = (f"{form} {row['inside_deg']:.2f} deg" for form, row in validation["forms"].items())
        left_out = f"cross-validation within the span, {validation['left_out']} left out"
        yield f"\n{left_out}: {', '.join(forms)}"
    yield from (f"assumed: {line}" for line in model.provenance.get("assumed", []))


def plot_calibration(table, model, path):
    """Plot phases, at the turn closest to the curves, and residuals over force."""
    from gnuradio.wiforce.receiver.plotting import legend_beside
    from matplotlib.figure import Figure

    rows = [(index, port) for index in range(len(model.carriers)) for port in (1, 2)]
    canvas = Figure(figsize=(10, 0.6 + 3.0 * len(rows)), layout="constrained")
    panels = canvas.subplots(len(rows), 2, squeeze=False)
    canvas.suptitle(f"{model.name}: points measured, lines model")
    forces = np.linspace(*model.force_span_n, _POINTS)
    for (index, port), (phases, residuals) in zip(rows, panels, strict=True):
        carrier = model.carriers[index]
        own = (table.port == port) & same_carrier(table.frequency_hz, carrier.frequency_hz)
        pressed = table.take(own & (table.force_n > 0))
        for number, location in enumerate(carrier.location_mm):
            style = series_style(number)
            here = pressed.take(pressed.location_mm == location)
            curve, expected = (
                model.short_deg(force, np.full(len(force), location), index)[:, port - 1]
                for force in (forces, here.force_n)
            )
            beside = wrap_deg(here.phase_deg - expected)
            phases.plot(forces, curve, color=style["color"])
            phases.plot(here.force_n, expected + beside, ls="", ms=2.5, **style)
            residuals.plot(here.force_n, beside, ls="", ms=3, label=f"{location:g} mm", **style)
        phases.set_title(f"{carrier.frequency_hz / 1e6:g} MHz, port {port}", fontsize=10)
        phases.set_ylabel("phase (deg)")
        residuals.set_ylabel("measured - model (deg)")
        residuals.axhline(0.0, color=FAINT, lw=0.8)
        for axis in (phases, residuals):
            axis.set_xlabel("force (N)")
            axis.grid(alpha=0.3)
        legend_beside(residuals)
    save_picture(canvas, path)


@click.command(
    cls=GroupedHelp, examples=("transfer arm.yaml --frequency-hz 915e6 -o arm-915.yaml",)
)
@click.argument("source", metavar="SENSOR", shell_complete=sensor_names)
@click.option("--frequency-hz", type=CARRIER_HZ, required=True, help="The new carrier.")
@sensor_output
@click.option("--name", help="Name of the sensor; the output's name by default.")
def transfer(source, frequency_hz, output, name):
    """Transfer a SENSOR, shipped or a file, to a carrier within 10 % of its own.

    Contact positions in millimetres stay as they are and phases scale with frequency. Connectors
    follow no such rule: the file states the uncertainty that this adds to every phase.
    """
    check_output(output, [source])
    moved = sensor.load_sensor(source).transferred(frequency_hz, name or Path(output).stem)
    sensor.write_sensor(moved, output)
    added = moved.transfer_std_deg
    click.echo(
        f"sensor {moved.name}: {frequency_hz / 1e6:g} MHz, "
        + (
            "evaluated by physics, no uncertainty added"
            if added is None
            else f"calibrated at {moved.transferred_from_hz / 1e6:g} MHz, {added:.2g} deg added to "
            "the standard deviation of each phase"
        )
    )
    click.echo(f"written: {output}")
