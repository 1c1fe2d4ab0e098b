# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of subcommands whose modules are imported only when asked for."""

import importlib
import importlib.util

import click


class LazyGroup(click.Group):
    """The modules of a package that hold a command of their own name.

    Parameters
    ----------
    package : str
    names : sequence of str
        In the order of the help text; a name without a module is left out.
    """

    def __init__(self, *arguments, package, names, **options):
        super().__init__(*arguments, **options)
        self._package, self._names = package, names

    def list_commands(self, ctx):
        return [name for name in self._names if importlib.util.find_spec(self._module(name))]

    def get_command(self, ctx, name):
        if name not in self.list_commands(ctx):
            return None
        return getattr(importlib.import_module(self._module(name)), name.replace("-", "_"))

    def _module(self, name):
        return f"{self._package}.{name.replace('-', '_')}"
