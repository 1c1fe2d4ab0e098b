# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of subcommands that are imported on first use, and help by headings."""

import difflib
import gc
import importlib
from contextlib import contextmanager

import click
from gnuradio.wiforce.errors import InputError, gnuradio_rule


class LazyGroup(click.Group):
    """A group of commands, each a function of the same name in a module of ``package``.

    ``commands`` has module and a line of help, so that help imports none.
    """

    def __init__(self, *arguments, package, commands, groups=None, examples=(), **options):
        super().__init__(*arguments, **options)
        self._package, self._commands = package, commands
        self._groups = groups or {"Commands": " ".join(commands)}
        self._examples = examples

    def list_commands(self, ctx):
        return list(self._commands)

    def get_command(self, ctx, name):
        if name not in self._commands:
            return None
        with _gnuradio_named(name):
            module = importlib.import_module(self._commands[name][0], self._package)
        # What was loaded stays, and is never searched for cycles (`run` of the package).
        gc.freeze()
        gc.enable()
        return getattr(module, name.replace("-", "_"))

    def resolve_command(self, ctx, args):
        name = args[0]
        unknown = name[:1].isalpha() and self.get_command(ctx, name) is None
        if unknown and not ctx.resilient_parsing:
            near = difflib.get_close_matches(name, self._commands, n=1)
            hint = f"Did you mean '{near[0]}'?" if near else f"See {ctx.command_path} --help."
            ctx.fail(f"No such command '{name}'. {hint}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx):
        with _gnuradio_named(ctx):
            return super().invoke(ctx)

    def format_commands(self, ctx, formatter):
        widest = max(map(len, self._commands))
        for heading, names in self._groups.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [(name.ljust(widest), self._commands[name][1]) for name in names.split()]
                )
        _write_examples(ctx, formatter, self._examples)


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


_HELP = ("--help-all", "--help")
_EVERYTHING = "gr-wiforce: explain all options"  # of a context, where the help is to do so


class GroupedHelp(click.Command):
    """A command whose help fits on a screen: ``--help`` explains the first of ``groups``."""

    def __init__(self, *arguments, groups=None, examples=(), **options):
        super().__init__(*arguments, **options)
        self._groups, self._examples = groups or {"Options": ""}, examples
        if len(self._groups) > 1:
            flag = {"is_flag": True, "is_eager": True, "expose_value": False, "callback": _show_all}
            click.option("--help-all", help="Explain all options.", **flag)(self)

    def full_help(self, ctx):
        """The help with every option explained, as text."""
        ctx.meta[_EVERYTHING] = True
        try:
            return self.get_help(ctx)
        finally:
            del ctx.meta[_EVERYTHING]  # parents and other commands have the same one

    def format_options(self, ctx, formatter):
        everything = ctx.meta.get(_EVERYTHING, False)
        known = {name: each for each in self.get_params(ctx) for name in each.opts}
        first = next(iter(self._groups))
        grouped = {*" ".join(self._groups.values()).split(), *_HELP}
        for heading, names in self._groups.items():
            listed = [known[name] for name in names.split()]
            if heading == first:
                options = (each for each in self.params if isinstance(each, click.Option))
                listed += [each for each in options if grouped.isdisjoint(each.opts)]
                listed += [known[name] for name in _HELP if name in known]
            shown = list(filter(None, (each.get_help_record(ctx) for each in listed)))
            if everything or heading == first:
                with formatter.section(heading):
                    formatter.write_dl(shown)
        if not everything and len(self._groups) > 1:
            with formatter.section("More, explained by --help-all"):
                others = list(self._groups.items())[1:]
                formatter.write_dl([(heading, names) for heading, names in others])
        _write_examples(ctx, formatter, self._examples)


def _write_examples(ctx, formatter, examples):
    if examples:
        with formatter.section("Examples"):
            for example in examples:
                formatter.write_text(f"{ctx.find_root().info_name} {example}")


def _show_all(ctx, _, asked):
    if asked and not ctx.resilient_parsing:
        click.echo(ctx.command.full_help(ctx))
        ctx.exit()
