# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command: loads its subcommands and reports every failure in one line."""

import atexit
import errno
import gc
import io
import logging
import os
import sys
import traceback
import warnings

import click
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.errors import InputError, OutputError

from .shell.commands import LazyGroup
from .shell.interrupts import (
    BAD_INPUT,
    DONE,
    FAILED,
    INTERRUPTED,
    OUTPUT_CLOSED,
    TERMINATED,
    Interrupted,
    Terminated,
    interrupt_by_exception,
)
from .shell.log import PROGRAM, log

# Module and one line of help of each subcommand, so that --help imports none of them.
COMMANDS = {
    "demo": (".scenes.demo", "Simulate two presses, read them, compare with the truth."),
    "list": (".scenes.scenes", "List shipped scenes and sensor models."),
    "simulate": (".scenes.scenes", "Simulate a scene and write its capture."),
    "read": (".read.read", "Read force and location from a capture."),
    "survey": (".plan.survey", "Show what is in the room of a capture."),
    "score": (".evaluate.score", "Compare readings with the record of a force gauge."),
    "export": (".read.export", "Convert readings to CSV, JSON lines, Parquet, MCAP."),
    "check": (".plan.check", "Check a radio, or the files of a capture."),
    "live": (".live.live", "Read force and location live from a radio."),
    "watch": (".web.watch", "Show readings in a browser."),
    "status": (".live.clients", "Print the health of a live reader."),
    "keys": (".live.clients", "Make keys for ZMQ beyond this machine."),
    "emulate": ("software_n210.command", "Run a software USRP N210 that simulates a scene."),
    "plan": (".plan.plan", "Show errors to expect of a scene, and what limits them."),
    "design": (".plan.design", "Show impedance and timer of a tag to build."),
    "calibrate": (".calibrate.calibrate", "Make a sensor model from known presses."),
    "transfer": (".calibrate.calibrate", "Transfer a sensor model to another carrier."),
    "off-reflection": (".calibrate.off_reflection", "Estimate the off state of the switches."),
    "invert": (".calibrate.invert", "Convert measured phases to force and location."),
    "schema": (".scenes.scenes", "Print the JSON Schema of scene or sensor files."),
    "evaluate": (".evaluate.evaluate", "Compare readings with the truth and the paper."),
    "bench": (".bench", "Measure accuracy, speed and numerical limits."),
}
_GROUPS = {
    "Begin": "demo list simulate",
    "Recordings": "read survey score export",
    "Radio": "check live watch status keys emulate",
    "Sensors and tags": "calibrate transfer off-reflection invert design schema",
    "Study": "plan evaluate bench",
}
# System errors caused by an unusable path count as bad input; others, such as a full disk, do not.
_PATH_ERRORS = {
    errno.EACCES,
    errno.EISDIR,
    errno.ELOOP,
    errno.ENAMETOOLONG,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EROFS,
}


def _set_debug(ctx, _, asked):
    ctx.find_root().obj["debug"] = asked
    if asked:
        warnings.simplefilter("default")


@click.command(
    cls=LazyGroup,
    package=__package__,
    commands=COMMANDS,
    groups=_GROUPS,
    examples=("read press -o press.csv --plot press.png",),
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog="Exit status: 0, 2 bad input, 1 failure, 130 Ctrl-C, 143 SIGTERM, 141 closed. What runs "
    "until interrupted (live, watch, emulate, read --follow) ends with 0 then.",
)
@click.version_option(VERSION, message="%(prog)s %(version)s")
@click.option(
    "--debug",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_set_debug,
    help="Show the full traceback of an unexpected error.",
)
def command():
    """Contact force and location from a passive wireless sensor."""


def main(argv=None):
    """Run the command, by default with the arguments of the process; its exit status.

    0 success; 2 bad usage or input; 130 interrupted; 143 terminated; 141 standard output's reader
    is gone; 1 otherwise. What runs until interrupted ends with 0 then. Failures print one line on
    standard error, but for 141.
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
    except (click.Abort, KeyboardInterrupt, Interrupted) as error:
        return _end_of_interruption(error)
    except _OutputClosed:
        _silence(sys.stdout)
        return OUTPUT_CLOSED
    except SystemExit as error:  # how click ends on any other broken pipe, and after completions
        if error.__context__ is None:
            return error.code
        return _fail(FAILED, str(error.__context__ or error))
    except OSError as error:
        if state["debug"]:
            traceback.print_exc()
        _silence(sys.stdout)  # a full standard output would fail again when Python flushes it
        status = BAD_INPUT if error.errno in _PATH_ERRORS else FAILED
        named = f"{error.filename}: " if error.filename is not None else ""
        return _fail(status, f"{named}{error.strerror or error}")
    except Exception as error:
        if state["debug"]:
            traceback.print_exc()
        return _fail(FAILED, f"{type(error).__name__}: {error}")


def run():
    """Run the command as a process, whatever streams and environment it was started with."""
    _open_standard_streams()
    _find_home()
    _silence_libraries()
    interrupt_by_exception()
    log.set_up()
    status = main()
    # Or Python would search all that is left for cycles as it ends, which takes 0.1 s.
    gc.freeze()
    return status


def _find_home():
    """Provide a writable home folder, in which GNU Radio's FFT stores a file."""
    if not os.access(os.environ.get("HOME", ""), os.W_OK):
        import shutil
        import tempfile

        os.environ["HOME"] = tempfile.mkdtemp(prefix=f"{PROGRAM}-")
        atexit.register(shutil.rmtree, os.environ["HOME"], ignore_errors=True)


def _silence_libraries():
    """Discard warnings of libraries, unless --debug: they name nothing of the user's."""
    warnings.simplefilter("ignore")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


def _open_standard_streams():
    """Replace closed standard streams, so that no other file gets their descriptors."""
    for name, number, flags in (
        ("stdin", 0, os.O_RDONLY),
        ("stdout", 1, os.O_RDONLY),
        ("stderr", 2, os.O_WRONLY),
    ):
        if getattr(sys, name) is None:
            os.open(os.devnull, flags)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(_StandardOutput(1, "w", closefd=False)),
        sys.stdout.encoding,
        # A file name that the terminal cannot encode must not end the command.
        errors="backslashreplace",
        line_buffering=os.isatty(1),
    )


class _StandardOutput(io.FileIO):
    """Standard output whose errors name it, as those of a file name the file."""

    def write(self, data):
        try:
            return super().write(data)
        except BrokenPipeError:
            raise _OutputClosed from None
        except OSError as error:
            error.filename = "standard output"
            raise


class _OutputClosed(Exception):
    """The reader of standard output is gone. No OSError, of which click ends silently with 1."""


def _end_of_interruption(error):
    """Say what interrupted the command; click raises Abort from Ctrl-C."""
    causes = (error, error.__cause__, error.__context__)
    terminated = any(isinstance(cause, Terminated) for cause in causes)
    word, status = ("terminated", TERMINATED) if terminated else ("interrupted", INTERRUPTED)
    partial = f"; {error}" if isinstance(error, Interrupted) else ""
    _fail(status, word + partial)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # the terminal is closed
            _silence(stream)
    return status


def _with_command(error):
    context = error.ctx
    if context is not None and context.command.hidden:
        context = context.parent  # whose name users type
    name = context.info_name if context is not None else PROGRAM
    message = error.format_message()
    return message if name == PROGRAM else f"{name}: {message}"


def _fail(status, message):
    log.error(" ".join(message.split()))
    return status


def _silence(stream):
    """Discard the interpreter's last flush: a stream is full, or its reader is gone."""
    try:
        number = stream.fileno()
    except (OSError, ValueError):
        return  # not a file
    os.dup2(os.open(os.devnull, os.O_WRONLY), number)


if __name__ == "__main__":
    sys.exit(run())
