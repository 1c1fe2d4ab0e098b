# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce export``: a file of readings in another format."""

import struct
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.files import FORMATS, OUTPUTS, format_of
from gnuradio.wiforce.io.files.readings_files import ReadingsFile
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.outputs import STAMP_COLUMNS
from gnuradio.wiforce.io.ros_messages import READING, fields_of
from gnuradio.wiforce.io.text.textfile import check_output, replacing
from gnuradio.wiforce.scene import load_scene

from ..shell.commands import GroupedHelp
from ..shell.log import log, progress
from ..shell.options import scene_names
from ..shell.provenance import provenance

_SUFFIXES = {each.suffix[1:]: each.suffix for each in FORMATS} | {"json": ".jsonl"}


@click.command(cls=GroupedHelp, examples=("export press.csv --to mcap",))
@click.argument("readings", type=click.Path())
@click.option("--to", "form", type=click.Choice(list(_SUFFIXES)), help="Default: by OUT's suffix.")
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    metavar="OUT",
    help="OUT.mcap, OUT.parquet, OUT.csv or OUT.jsonl. Default: beside READINGS.",
)
@click.option(
    "--scene",
    "scene_path",
    shell_complete=scene_names,
    help="Scene to describe in MCAP or Parquet: file or name.",
)
def export(readings, form, output, scene_path):
    """Convert READINGS between CSV, JSON lines, Parquet and MCAP.

    OUT appears when it is complete. An MCAP file that a killed process has left is recovered.
    """
    output = _output_of(readings, form, output)
    metadata = {} if scene_path is None else provenance(load_scene(scene_path))
    source = ReadingsFile(readings)
    check_output(output, [readings])
    number, lost = 0, dict.fromkeys(_without_field(source.also, output), False)
    try:
        with (
            replacing(output) as part,
            _writer(part, output, source.also, {**source.metadata, **metadata}) as writer,
            progress("exporting", 0) as step,
        ):
            for row in source.rows():
                number += 1
                writer.write_rows([row])
                lost = {name: known or row[name] not in (None, "") for name, known in lost.items()}
                step(1)
    except InputError:
        raise
    except OutputError as error:
        # Nothing is kept of the hidden file that it names.
        raise OutputError(output, f"cannot be written ({error.reason})") from None
    except (ValueError, TypeError, OverflowError, struct.error) as error:
        # Parquet and MCAP write several rows at a time.
        rule = f"cannot be converted to {output.suffix[1:]}, row {number} or before ({error})"
        raise InputError(readings, rule) from error
    if any(lost.values()):
        names = ", ".join(name or "one without name" for name, known in lost.items() if known)
        log.warning(f"{readings}: columns without a field in MCAP are left out: {names}")
    if source.note:
        log.warning(f"{readings}: {source.note}")
    log.info(f"wrote {writer.rows} readings to {output}")


def _output_of(readings, form, output):
    if output is None:
        if form is None:
            raise click.UsageError("needs --to or --output")
        if not Path(readings).name:
            raise InputError("READINGS", "must be the name of a file", readings)
        return Path(readings).with_suffix(_SUFFIXES[form])
    suffix = Path(output).suffix.lower()
    expected = list(dict.fromkeys(_SUFFIXES.values())) if form is None else [_SUFFIXES[form]]
    if suffix not in expected:
        raise InputError("--output", f"must end in {' or '.join(expected)}", output)
    return Path(output)


def _without_field(also, output):
    """Names of the columns that the messages of an MCAP file have no fields for."""
    if output.suffix.lower() != ".mcap":
        return []
    return [n for n in also if n not in (*fields_of(READING), *STAMP_COLUMNS)]


def _writer(path, output, also, metadata):
    if path.suffix.lower() != output.suffix.lower():
        raise InputError(output, f"must not be a link to a device or a pipe: {path}")
    if format_of(path) not in OUTPUTS:
        from gnuradio.wiforce.io.files.mcap_file import McapWriter

        return McapWriter(path, metadata=metadata)
    return open_writer(path, also=also, metadata=metadata)
