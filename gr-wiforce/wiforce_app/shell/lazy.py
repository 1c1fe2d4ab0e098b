# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of subcommands whose modules are imported on first use."""

import difflib
import importlib
from contextlib import contextmanager

import click
from gnuradio.wiforce.errors import InputError, gnuradio_rule


class LazyGroup(click.Group):
    """A group of commands, each a function of the same name in a module.

    ``package``: package that relative names of modules refer to; ``commands``: module and one line
    of help by command, so that showing them imports none of the modules.
    """

    def __init__(self, *arguments, package, commands, **options):
        super().__init__(*arguments, **options)
        self._package, self._commands = package, commands

    def list_commands(self, ctx):
        return list(self._commands)

    def get_command(self, ctx, name):
        if name not in self._commands:
            return None
        with _gnuradio_named(name):
            module = importlib.import_module(self._commands[name][0], self._package)
            return getattr(module, name.replace("-", "_"))

    def invoke(self, ctx):
        with _gnuradio_named(ctx):
            return super().invoke(ctx)

    def resolve_command(self, ctx, args):
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = difflib.get_close_matches(args[0], self._commands, n=1)
            if near:
                error.message += f" Did you mean '{near[0]}'?"
            raise

    def format_commands(self, ctx, formatter):
        rows = [(name, text) for name, (_, text) in self._commands.items()]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


@contextmanager
def _gnuradio_named(where):
    """Report in one line that a subcommand, or an option of it, needs GNU Radio."""
    try:
        yield
    except ImportError as error:
        rule = gnuradio_rule(error)
        if rule is None:
            raise
        name = where if isinstance(where, str) else where.invoked_subcommand
        raise InputError(name, rule) from error
