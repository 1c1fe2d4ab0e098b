# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of subcommands whose modules are imported on first use."""

import difflib
import importlib
from contextlib import contextmanager

import click
from gnuradio.wiforce.errors import InputError, gnuradio_rule


class LazyGroup(click.Group):
    """A group of commands, each in a module of the same name.

    Parameters
    ----------
    package : str
        Package of the modules.
    helps : dict
        One line of help per command, so that showing them imports none of the modules.
    elsewhere : dict, optional
        Full names of the modules that are not in the package, by command.
    """

    def __init__(self, *arguments, package, helps, elsewhere=None, **options):
        super().__init__(*arguments, **options)
        self._package, self._helps, self._elsewhere = package, helps, elsewhere or {}

    def list_commands(self, ctx):
        return list(self._helps)

    def get_command(self, ctx, name):
        if name not in self._helps:
            return None
        with _gnuradio_named(name):
            return getattr(importlib.import_module(self._module(name)), name.replace("-", "_"))

    def invoke(self, ctx):
        with _gnuradio_named(ctx):
            return super().invoke(ctx)

    def resolve_command(self, ctx, args):
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = difflib.get_close_matches(args[0], self._helps, n=1)
            if near:
                error.message += f" Did you mean '{near[0]}'?"
            raise

    def format_commands(self, ctx, formatter):
        rows = [(name, self._helps[name]) for name in self.list_commands(ctx)]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)

    def _module(self, name):
        return self._elsewhere.get(name, f"{self._package}.{name.replace('-', '_')}")


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
