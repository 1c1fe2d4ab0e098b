# SPDX-License-Identifier: GPL-3.0-or-later
"""What every test runs under: the right interpreter, its own HOME, and an end."""

import faulthandler
import os
import signal
import sys

import pytest
from software_usrp import software_usrp  # noqa: F401

TIMEOUT_S = 120
# Threads only slow down matrices as small as ours. To be set before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="Run what runs by the number at length.")


@pytest.fixture(scope="session")
def long_run(request):
    """Whether numbers of runs are to be those of the long command."""
    return request.config.getoption("--long")


def pytest_configure(config):
    config.addinivalue_line("markers", f"timeout(seconds): instead of {TIMEOUT_S} s")
    try:
        from gnuradio import gr, wiforce  # noqa: F401
    except ImportError as error:
        raise pytest.UsageError(
            f"{sys.executable} finds no GNU Radio with wiforce ({error}); "
            "run the tests with: build/run pytest tests"
        ) from error


@pytest.fixture(autouse=True, scope="session")
def own_home(tmp_path_factory):
    """GNU Radio and grcc write to the home folder: give them one of their own."""
    home = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(home))
        patch.setenv("XDG_CACHE_HOME", str(home / "cache"))
        patch.setenv("XDG_CONFIG_HOME", str(home / "config"))
        patch.setenv("MPLBACKEND", "Agg")
        yield home


@pytest.fixture(autouse=True)
def time_limit(request):
    """Fails a test that hangs, with its stack; ends the run if it hangs outside Python."""
    marker = request.node.get_closest_marker("timeout")
    seconds = marker.args[0] if marker else TIMEOUT_S

    def expired(signum, frame):
        faulthandler.dump_traceback(file=sys.__stderr__)
        pytest.fail(f"still running after {seconds} s")

    before = signal.signal(signal.SIGALRM, expired)
    signal.alarm(seconds)
    # A signal is handled between bytecodes: a flowgraph that hangs in C++ never gets there.
    faulthandler.dump_traceback_later(seconds + 10, exit=True, file=sys.__stderr__)
    yield
    faulthandler.cancel_dump_traceback_later()
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="session")
def qt():
    """Qt without a screen; one application per process is all that Qt allows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QT_QPA_PLATFORM", "offscreen")
        from PyQt5.QtWidgets import QApplication

        yield QApplication.instance() or QApplication(["tests"])
