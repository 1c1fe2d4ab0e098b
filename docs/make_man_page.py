#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes docs/gr-wiforce.1, the man page, from the help of the command.

build/run python3 docs/make_man_page.py
"""

import re
from pathlib import Path

import click
from gnuradio.wiforce._config import VERSION
from wiforce_app.main import PROGRAM, command

PAGE = Path(__file__).resolve().parent / f"{PROGRAM}.1"
_EPILOGUE = r"""
.SH EXIT STATUS
.TP
.B 0
Success.
.TP
.B 2
Bad usage or bad input: one line on standard error names the file or option, the rule and the value.
.TP
.B 1
Any other failure.
.TP
.B 130
Interrupted by Ctrl\-C. What runs until interrupted (live, watch, emulate, read \-\-follow) ends
with 0 then, as by SIGTERM.
.TP
.B 141
Standard output was closed early, as by head. Nothing is printed.
.TP
.B 143
Ended by SIGTERM.
.SH FILES
Captures are SigMF pairs (.sigmf\-meta, .sigmf\-data). Readings are CSV or JSON lines, one row
per phase group and sensor. Scenes and sensors are YAML files; shipped ones are available by name.
.SH EXAMPLES
.nf
gr\-wiforce simulate tabletop press
gr\-wiforce read press \-\-scene tabletop \-o readings.csv \-\-plot readings.png
.fi
.SH SHELL COMPLETION
Installed for bash, zsh and fish. From a build tree, in bash:
.PP
.nf
eval "$(_GR_WIFORCE_COMPLETE=bash_source gr\-wiforce)"
.fi
"""


def roff(text):
    """Text with the special characters of roff escaped."""
    text = " ".join(str(text).replace("\b", " ").split())
    text = text.replace("\\", r"\\").replace("-", r"\-")
    return re.sub(r"^([.'])", r"\\&\1", text)


def option_lines(parameter):
    if isinstance(parameter, click.Option) and not parameter.hidden:
        names = ", ".join([*parameter.opts, *parameter.secondary_opts])
        value = "" if parameter.is_flag or parameter.count else f" {parameter.make_metavar()}"
        yield from (".TP", rf"\fB{roff(names)}\fR{roff(value) and ' ' + roff(value)}")
        default = parameter.default
        known = isinstance(default, str | int | float) and default != ""
        stated = known and not parameter.is_flag and parameter.show_default is not False
        yield roff((parameter.help or "") + (f" Default: {default}." if stated else ""))


def command_lines(name, each):
    # Click keeps the first names of the option for help.
    context = click.Context(each, info_name=name, **command.context_settings)
    if isinstance(each, click.Group):
        for sub in each.list_commands(context):
            yield from command_lines(f"{name} {sub}", each.get_command(context, sub))
        return
    usage = " ".join(each.collect_usage_pieces(context))
    yield from (f".SS {roff(name)}", rf"\fB{roff(name)}\fR {roff(usage)}", ".PP", roff(each.help))
    for parameter in each.params:
        yield from option_lines(parameter)


def page():
    """The man page as roff."""
    context = click.Context(command, info_name=PROGRAM)
    lines = [
        r".\" Written by docs/make_man_page.py.",
        f'.TH {PROGRAM.upper()} 1 "" "{PROGRAM} {VERSION}"',
        ".SH NAME",
        rf"{roff(PROGRAM)} \- {roff(command.help)[0].lower()}{roff(command.help)[1:].rstrip('.')}",
        ".SH SYNOPSIS",
        rf"\fB{roff(PROGRAM)}\fR [\fIOPTIONS\fR] \fICOMMAND\fR [\fIARGUMENTS\fR]",
        ".SH OPTIONS",
    ]
    for parameter in command.params:
        lines += option_lines(parameter)
    lines.append(".SH COMMANDS")
    for name in command.list_commands(context):
        lines += command_lines(name, command.get_command(context, name))
    return "\n".join(lines) + _EPILOGUE


def files():
    """{path: roff} of the page."""
    return {PAGE: page()}


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
