# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command, a folder per task: `main` lists the subcommands and their modules.

`scenes`, `plan`, `calibrate`, `read` and `live` are the tasks of a measurement, in their order;
`radio` is the devices of `live`, and `web` its page in a browser. `evaluate` and `bench` measure
the receiver itself. `shell` is what all of them share.
"""

import gc
import os
import signal
from importlib.util import find_spec
from pathlib import Path

import gnuradio

from .shell.interrupts import INTERRUPTED


def blas_settings(cpuinfo=Path("/proc/cpuinfo"), numpy=None):
    """Environment variables of OpenBLAS, read when NumPy is imported and multiplies matrices by it.

    One thread, which matrices as small as ours need. A system's OpenBLAS older than the processor
    is four times slower, so that AVX2 and FMA are stated; NumPy's wheels choose themselves.
    """
    chosen = {"OPENBLAS_NUM_THREADS": "1"}
    if numpy is None and (found := find_spec("numpy")) is not None and found.origin:
        numpy = Path(found.origin).parent
    if numpy is not None and numpy.with_name("numpy.libs").is_dir():
        return chosen
    try:
        # Only up to the first processor's flags: many processors take long to list.
        with cpuinfo.open(encoding="utf-8", errors="replace") as lines:
            flags = next((line.split() for line in lines if line.startswith("flags")), [])
    except OSError:
        return chosen
    if {"avx2", "fma"} <= set(flags):
        chosen["OPENBLAS_CORETYPE"] = "Haswell"
    return chosen


# To be set before NumPy is imported.
for _name, _value in blas_settings().items():
    os.environ.setdefault(_name, _value)

# The library that was installed with this command. GNU Radio lists its own folder, where
# another release of the library may be, before those of other packages.
_own = str(Path(__file__).parent.parent / "gnuradio")
if isinstance(gnuradio.__path__, list) and _own in gnuradio.__path__:
    gnuradio.__path__.remove(_own)
    gnuradio.__path__.insert(0, _own)


def run():
    """Run the command as a process; returns its exit status.

    Ctrl-C while the rest is loaded, which takes longer than typing it, ends the command by one
    line, not by a traceback.
    """
    # A shell's background command ignores Ctrl-C, and goes on doing so.
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)
    # Or Python would search what it loads for cycles again and again, which takes 10 ms.
    gc.disable()
    from .main import run

    return run()


def _end(*_):
    os.write(2, b"gr-wiforce: interrupted\n")
    os._exit(INTERRUPTED)
