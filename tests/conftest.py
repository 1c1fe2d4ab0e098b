# SPDX-License-Identifier: GPL-3.0-or-later
"""Conditions of every test: the right interpreter, a HOME of its own, and a time limit."""

import faulthandler
import fcntl
import gc
import json
import os
import signal
import subprocess
import sys
import threading
from itertools import zip_longest
from pathlib import Path

import pytest
import wiforce_app  # noqa: F401  how OpenBLAS is used, before NumPy is imported
from command_runs import run_command
from live_runs import SLOW, scene_file
from software_usrp import SoftwareUsrp, soapy_player, software_usrp  # noqa: F401

ROOT = Path(__file__).parent
# Several times what a test takes on a busy machine.
TIMEOUT_S = 400
# Folders whose tests wait for a device most of the time.
WITH_DEVICE = ("live", "radio", "software_n210")
# Files that take or wait for ten seconds and more, by their time: with a device, and without.
LONGEST = (
    *("qa_live_reconnect", "qa_live_presses", "qa_live_examples"),
    *("qa_live_requests", "qa_soapy_player", "qa_live_health", "qa_guided_live", "qa_live_ends"),
    *("qa_device", "qa_programs", "qa_live_refusals", "qa_check"),
    *("qa_packets", "qa_press_sequences", "qa_card_effects", "qa_read", "qa_plausibility"),
    *("qa_examples", "qa_format", "qa_card_clocks", "qa_golden", "qa_docs"),
    *("qa_simulation_channel", "qa_flowgraph_mistakes", "qa_fuzz", "qa_rooms_read", "qa_web_page"),
    *("qa_stream", "qa_interference", "qa_estimation_separation", "qa_pictures"),
    *("qa_sensor_calibration", "qa_many_captures", "qa_survey", "qa_calibration_session"),
    *("qa_estimation_clock_lines", "qa_command", "qa_doctests", "qa_planning_plan", "qa_slips"),
    *("qa_estimation_clock", "qa_usrp", "qa_chain_blocks"),
    *("qa_sample_streams", "qa_sensor_inversion", "qa_faults", "qa_workers", "qa_check_file"),
    *("qa_capture_scene", "qa_guided_calibration", "qa_receiver", "qa_bench_stress"),
    *("qa_waveforms", "qa_sensor_file", "qa_estimation_frame", "qa_surface"),
)
# Workers and hundreds of processes import the same files: without their bytecode each compiles them
# again, pytest with rewritten assertions in several seconds.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


# A shell starts what runs in the background with SIGINT ignored, and its children would be as deaf.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption(
        "--long", action="store_true", help="Run the long forms of tests that have one."
    )


@pytest.fixture
def numbers_without_types():
    """NumPy 2 shows the types of its numbers, as examples for any version cannot."""
    import numpy as np

    with np.printoptions(**({} if np.__version__.startswith("1.") else {"legacy": "1.25"})):
        yield


@pytest.fixture(scope="session")
def long_run(request):
    """Whether tests run in their long form."""
    return request.config.getoption("--long")


def pytest_configure(config):
    gc.disable()  # nothing of what is collected becomes garbage
    config.addinivalue_line("markers", f"timeout(seconds): time limit instead of {TIMEOUT_S} s")
    config.addinivalue_line("markers", "long: runs with --long only, since other cases say as much")
    try:
        from gnuradio import gr, wiforce  # noqa: F401
    except ImportError as error:
        raise pytest.UsageError(
            f"{sys.executable} finds no GNU Radio with wiforce ({error}); "
            "run the tests with: build/run pytest tests"
        ) from error


def pytest_collection_modifyitems(config, items):
    """Leave out what needs --long, and sort files.

    The longest come first, waiting for a device and computing in turn. Workers take whole files in
    this order. All cores are busy while some tests wait, and no long file is left for the end.
    """
    if not config.getoption("--long"):
        left_out = [item for item in items if item.get_closest_marker("long")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("long")]
    rank = {name: number for number, name in enumerate(LONGEST)}
    waiting, computing = {}, {}
    for item in sorted(items, key=lambda item: rank.get(item.path.stem, len(rank))):
        files = waiting if item.path.parent.name in WITH_DEVICE else computing
        files.setdefault(item.path, []).append(item)
    pairs = zip_longest(waiting.values(), computing.values(), fillvalue=[])
    items[:] = [item for pair in pairs for file in pair for item in file]


def pytest_collection_finish():
    """Leave the tests and what they have imported out of all later garbage collections."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True, scope="session")
def own_home(tmp_path_factory, pytestconfig):
    """A home folder for the tests, since GNU Radio and grcc write to it.

    Caches are kept from run to run: Matplotlib's of fonts and grcc's of block descriptions take
    seconds to fill.
    """
    home = tmp_path_factory.mktemp("home")
    caches = pytestconfig.cache.mkdir("home")
    (home / ".cache").symlink_to(caches)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(home))
        patch.setenv("XDG_CACHE_HOME", str(caches))
        patch.setenv("XDG_CONFIG_HOME", str(home / "config"))
        patch.setenv("MPLBACKEND", "Agg")
        yield home


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """The folder of the demo, to be read only, and its finished run: one for all workers."""
    root = tmp_path_factory.getbasetemp()
    root = root.parent if "PYTEST_XDIST_WORKER" in os.environ else root
    folder, said = root / "demo", root / "demo.json"
    with open(root / "demo.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not said.exists():
            done = run_command("demo", "--folder", folder)
            said.write_text(json.dumps([done.returncode, done.stdout, done.stderr]))
    return folder, subprocess.CompletedProcess("demo", *json.loads(said.read_text()))


@pytest.fixture(autouse=True)
def time_limit(request):
    """Fail a test that hangs, with its stack; end the run if it hangs outside Python."""
    marker = request.node.get_closest_marker("timeout")
    seconds = marker.args[0] if marker else TIMEOUT_S

    def expired(signum, frame):
        # It was no hang outside Python, and the report may take a busy machine long.
        faulthandler.cancel_dump_traceback_later()
        faulthandler.dump_traceback(file=sys.__stderr__)
        pytest.fail(f"still running after {seconds} s")

    # On a busy machine execnet may start a worker's tests in another thread than the main one,
    # where no signal can be handled: the end of the process below is left then.
    signalled = threading.current_thread() is threading.main_thread()
    if signalled:
        before = signal.signal(signal.SIGALRM, expired)
        signal.alarm(seconds)
    # A signal is handled between bytecodes, and a flowgraph that hangs in C++ never gets there: its
    # process ends, and the whole run, since pytest-xdist does not go on without a worker.
    faulthandler.dump_traceback_later(seconds + 60, exit=True, file=sys.__stderr__)
    yield
    faulthandler.cancel_dump_traceback_later()
    if signalled:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def slow_scene(tmp_path_factory):
    """An untouched sensor at a low rate."""
    return scene_file(tmp_path_factory.mktemp("slow"), [], 400, 0.3, **SLOW)


@pytest.fixture(scope="module")
def slow_device(slow_scene):
    """A device that serves one test after the other; each session begins the scene anew."""
    device = SoftwareUsrp(slow_scene)
    yield device
    device.stop()


@pytest.fixture(scope="session")
def qt():
    """Qt without a screen; Qt allows one application per process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QT_QPA_PLATFORM", "offscreen")
        from PyQt5.QtWidgets import QApplication

        yield QApplication.instance() or QApplication(["tests"])
