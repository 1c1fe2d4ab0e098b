# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of subcommands whose modules are imported only when asked for."""

import importlib

import click


class LazyGroup(click.Group):
    """The modules of a package that hold a command of their own name.

    Parameters
    ----------
    package : str
    helps : dict
        A line of help by name, so that showing them imports none of the modules.
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
        return getattr(importlib.import_module(self._module(name)), name.replace("-", "_"))

    def format_commands(self, ctx, formatter):
        rows = [(name, self._helps[name]) for name in self.list_commands(ctx)]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)

    def _module(self, name):
        return self._elsewhere.get(name, f"{self._package}.{name.replace('-', '_')}")
