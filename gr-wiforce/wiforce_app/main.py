# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command: finds its subcommands, and turns every failure into one line."""

import atexit
import errno
import os
import shutil
import sys
import tempfile
import traceback

import click
from gnuradio.wiforce.errors import InputError, OutputError

from .lazy import LazyGroup

PROGRAM = "gr-wiforce"
# A line of help each, so that --help imports none of them.
COMMANDS = {
    "demo": "Simulate a press, read it back, show it beside the truth.",
    "list": "Shipped scenes and sensor models, by name.",
    "simulate": "Write the capture of a scene and its truth.",
    "read": "Read a capture to force and location.",
    "live": "Read from a USRP as it happens.",
    "check": "Look at a USRP's levels, noise, delay and tones before measuring.",
    "calibrate": "Make a sensor model from VNA or tap data.",
    "off-reflection": "Find the switches' off state from a capture with presses.",
    "invert": "Turn phases measured by anything into force and location.",
    "plan": "Say which steps a scene needs, and what each costs.",
    "emulate": "A software USRP N210 with a scene on the air.",
    "evaluate": "Error tables against truth and against the paper.",
    "bench": "Measure accuracy, speed and numerical limits.",
}
# What the system says of a name that cannot be used: bad input; all else (a full disk) is not.
_BAD_NAMES = {
    errno.EACCES,
    errno.EISDIR,
    errno.ELOOP,
    errno.ENAMETOOLONG,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EROFS,
}
DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def _print_version(ctx, _, asked):
    if asked and not ctx.resilient_parsing:
        from gnuradio.wiforce._config import VERSION

        click.echo(f"{PROGRAM} {VERSION}")
        ctx.exit()


def _set_debug(ctx, _, asked):
    ctx.find_root().obj["debug"] = asked


@click.command(
    cls=LazyGroup,
    package=__package__,
    helps=COMMANDS,
    elsewhere={"emulate": "software_n210.command"},
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit status: 0 done; 2 bad usage or bad input, with one line that says what; "
    "1 anything else.",
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
@click.option(
    "--debug",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_set_debug,
    help="Show the full traceback of an unexpected error.",
)
def command():
    """Contact force and its location from a passive wireless sensor."""


def main(argv=None):
    """Run the command.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the program's name; those of the process by default.

    Returns
    -------
    int
        Exit status: 0 done; 2 bad usage or bad input; 130 interrupted; 1 anything else. Every
        failure prints one line on standard error.
    """
    state = {"debug": False}
    try:
        result = command.main(argv, prog_name=PROGRAM, obj=state, standalone_mode=False)
        sys.stdout.flush()
        return result if isinstance(result, int) else DONE
    except click.UsageError as error:
        return _fail(BAD_INPUT, _with_command(error))
    except click.ClickException as error:
        return _fail(BAD_INPUT, error.format_message())
    except InputError as error:
        return _fail(BAD_INPUT, str(error))
    except OutputError as error:
        return _fail(FAILED, str(error))
    except (click.Abort, KeyboardInterrupt):
        return _fail(INTERRUPTED, "interrupted")
    except BrokenPipeError:
        _silence_stdout()
        return FAILED
    except OSError as error:
        if state["debug"]:
            traceback.print_exc()
        _silence_stdout()  # if it is the one that is full, Python would fail again at its end
        status = BAD_INPUT if error.errno in _BAD_NAMES else FAILED
        named = f"{error.filename}: " if error.filename is not None else ""
        return _fail(status, f"{named}{error.strerror or error}")
    except Exception as error:
        if state["debug"]:
            traceback.print_exc()
        return _fail(FAILED, f"{type(error).__name__}: {error}")


def run():
    """The command as a process, whatever that process was started with; its exit status."""
    _open_standard_streams()
    _find_home()
    return main()


def _find_home():
    """A folder for GNU Radio's FFT, which keeps a file in the home folder, or fails."""
    if not os.access(os.environ.get("HOME", ""), os.W_OK):
        os.environ["HOME"] = tempfile.mkdtemp(prefix=f"{PROGRAM}-")
        atexit.register(shutil.rmtree, os.environ["HOME"], ignore_errors=True)


def _open_standard_streams():
    """Takes the place of closed ones, so that no file gets their numbers.

    What is written to a closed standard output fails as on any system; what is said on a closed
    standard error goes nowhere.
    """
    for name, number, flags in (
        ("stdin", 0, os.O_RDONLY),
        ("stdout", 1, os.O_RDONLY),
        ("stderr", 2, os.O_WRONLY),
    ):
        if getattr(sys, name) is None:
            os.open(os.devnull, flags)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))
    # A name that the terminal's encoding has not is no reason to end.
    sys.stdout.reconfigure(errors="backslashreplace")


def _with_command(error):
    name = error.ctx.info_name if error.ctx is not None else PROGRAM
    message = error.format_message()
    return message if name == PROGRAM else f"{name}: {message}"


def _fail(status, message):
    line = "".join(c if c.isprintable() else " " for c in message)
    click.echo(f"{PROGRAM}: {' '.join(line.split())}", err=True)
    return status


def _silence_stdout():
    """Whoever read our output is gone or full: let the interpreter's last flush go nowhere."""
    try:
        stdout = sys.stdout.fileno()
    except (OSError, ValueError):
        return  # not a file
    os.dup2(os.open(os.devnull, os.O_WRONLY), stdout)


if __name__ == "__main__":
    sys.exit(run())
