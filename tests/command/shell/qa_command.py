# SPDX-License-Identifier: GPL-3.0-or-later
"""The command: subcommands, one line per failure, exit status."""

import json
import os
import pty
import re
import subprocess
import sys
import warnings
from dataclasses import replace

import click
import pytest
from command_runs import refused, run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.receiver.plotting import plot
from long_cases import cases
from wiforce_app import blas_settings
from wiforce_app import main as app
from wiforce_app.shell.plots import plot_readings


def run_process(*arguments, **options):
    return subprocess.run(
        ["gr-wiforce", *map(str, arguments)], capture_output=True, text=True, timeout=300, **options
    )


@pytest.fixture
def raising(monkeypatch):
    """Install a subcommand `fail` that raises a given error."""

    def install(error):
        @click.command()
        def fail():
            raise error

        monkeypatch.setattr(app.command, "get_command", lambda ctx, name: fail)

    return install


def helps(each, name):
    """Commands below this one that are not groups, by name."""
    if not hasattr(each, "list_commands"):
        return {name: each}
    context = click.Context(each, info_name=name)
    below = [helps(each.get_command(context, sub), sub) for sub in each.list_commands(context)]
    return {key: found for part in below for key, found in part.items()}


def test_help_fits_on_a_screen_and_explains_all_options_on_request():
    for name, each in helps(app.command, "gr-wiforce").items():
        settings = app.command.context_settings
        context = click.Context(each, info_name=name, terminal_width=80, **settings)
        shown = each.get_help(context)
        assert len(shown.splitlines()) <= 45, name
        everything = each.full_help(context) if hasattr(each, "full_help") else shown
        assert each.get_help(context) == shown, name
        for parameter in each.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                assert parameter.opts[-1] in shown, (name, parameter.opts)
                assert re.search(rf"^  .*{parameter.opts[-1]}\b", everything, re.M), parameter.opts


def test_help_of_simulate_loads_no_sensors():
    """It would take twice as long."""
    code = "import sys, wiforce_app.scenes.scenes; print(*sys.modules)"
    loaded = subprocess.check_output([sys.executable, "-c", code], text=True).split()
    assert "wiforce_app.scenes.scenes" in loaded and "numpy" not in loaded


def test_list_shows_shipped_names_with_a_description():
    from gnuradio.wiforce.scene import shipped_scenes
    from gnuradio.wiforce.sensor import shipped_sensors

    lines = run_command("list").stdout.splitlines()
    shown = dict(line.split(maxsplit=1) for line in lines if line.startswith("  "))
    assert list(shown) == [*shipped_scenes(), *shipped_sensors()]
    assert (
        shown["walker"].startswith("A person walks")
        and "simulated" in shown["line-900mhz-calibrated"]
    )
    assert run_command("list", "sensors").stdout.splitlines() == lines[lines.index("sensors") :]


LIVE = "live --scene demo --args x"
BAD_USAGE = {
    "nonsense": "No such command 'nonsense'. See gr-wiforce --help.",
    "raed press": "No such command 'raed'. Did you mean 'read'?",
    "bench sped": "bench: No such command 'sped'. Did you mean 'speed'?",
    "simulate": "simulate: Missing argument 'SCENE.yaml'",
    "simulate none.yaml x": "none.yaml: cannot be read",
    "simulate no\\nne.yaml x": "no ne.yaml: cannot be read",
    "emulate --air cable --speed nan": "--speed: must be positive and finite",
    f"{LIVE} --zmq \u00b2": "--zmq: must be a port",
    f"{LIVE} --control tcp://0.0.0.0:5556": (
        "--control: needs --zmq-keys for an address beyond loopback"
    ),
    f"{LIVE} --zmq-keys keys": "--zmq-keys: needs --zmq or --control",
    f"{LIVE} --zmq 5555 --zmq-keys none": (
        "none/server.key_secret: does not exist; `gr-wiforce keys FOLDER` makes keys"
    ),
    "status 5556 --zmq-keys none": "none: does not exist",
    "status tcp://:5556": "ENDPOINT: must be a port from 1 to 65535, or tcp://ADDRESS:PORT",
    "status tcp://*:5556": "ENDPOINT: cannot be connected to (ADDRESS must be that of",
    "keys none/keys": "none/keys: cannot be written (folder does not exist)",
    "keys /dev/null": "/dev/null: must be a folder, but is a file",
    f"{LIVE} --zmq tcp://nowhere.invalid:5555": (
        "--zmq: cannot be bound (ADDRESS must be an IPv4 address of this machine"
    ),
    "live --scene wifi_packets --args x": "--scene: must have no packets: a radio gives samples",
    "read demo paper_900": "demo: is a scene and not a capture; give it by --scene",
    "bench speed --megabytes 99999999999": "both recordings must fit on the disk",
    "check": "give --scene and --args for a device, or a FILE",
    "check --scene demo": "or a FILE",
    "check file --args addr=127.0.0.1": "FILE and --args exclude each other",
    "check --datatype ci16_le": "give a FILE",
    "check ": "'.': is not the name of a capture",
    "check /": "'/': is not the name of a capture",
    "export  --to csv": "READINGS: must be the name of a file, got ''",
    "design --width-mm 0": "--width-mm",
    "design --permittivity 0.5": "--permittivity",
    "design --frequency-hz nan": "--frequency-hz",
    "design --clock-hz 50000": "clock_hz: is not within reach",
    # It asked for 728 TiB.
    "design --width-mm 10000 --height-mm 0.001": "must be at most 200 times",
}


@pytest.mark.parametrize("arguments", BAD_USAGE)
def test_command_bad_usage_gives_one_line_and_status_2(tmp_path, arguments):
    words = [word.replace("\\n", "\n") for word in arguments.split(" ")]
    said = refused(*words, cwd=tmp_path)
    assert said.startswith("gr-wiforce: ") and BAD_USAGE[arguments] in said


@pytest.mark.parametrize(
    "error, status, line",
    [
        (InputError("x.yaml: a.b", "must be 1", 2), 2, "gr-wiforce: x.yaml: a.b: must be 1, got 2"),
        (InputError("x\x1b[1m\n", "is bad"), 2, "gr-wiforce: x [1m : is bad"),
        (RuntimeError("deep\ntrouble"), 1, "gr-wiforce: RuntimeError: deep trouble"),
        (KeyboardInterrupt(), 130, "gr-wiforce: interrupted"),
    ],
)
def test_command_failure_gives_one_line_and_its_status(raising, capsys, error, status, line):
    raising(error)
    assert app.main(["fail"]) == status
    assert capsys.readouterr().err.strip() == line


def test_debug_option_unexpected_error_shows_traceback(raising, capsys):
    raising(RuntimeError("trouble"))
    assert app.main(["--debug", "fail"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", cases(["list"], ["schema", "scene"], long=(["--help"], ["plan", "demo"]))
)
def test_command_closed_pipe_ends_silently_as_by_sigpipe(arguments):
    """A pipe into head must show no message, and a script must see that output is missing."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        ["gr-wiforce", *arguments], stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


def test_command_broken_pipe_that_is_not_standard_output_is_named(raising, capsys):
    """click ends silently on any broken pipe, also on one to another process."""
    raising(BrokenPipeError(32, "Broken pipe"))
    assert app.main(["fail"]) == 1
    assert "Broken pipe" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda: os.dup2(os.open("/dev/full", os.O_WRONLY), 1), "No space left on device"),
        # Otherwise the next opened file would get its descriptor, and the output.
        (lambda: os.close(1), "Bad file descriptor"),
    ],
)
def test_command_standard_output_that_takes_nothing_is_named(change, problem):
    done = run_process("list", preexec_fn=change)
    assert (done.returncode, done.stderr) == (1, f"gr-wiforce: standard output: {problem}\n")


def test_progress_in_pipe_is_silent_on_terminal_is_drawn():
    script = (
        "from wiforce_app.shell.log import progress\n"
        "with progress('working', 4) as done: done(2); done(2)\n"
    )
    piped = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=300)
    assert (piped.stdout, piped.stderr) == (b"", b"")
    terminal, end = pty.openpty()
    subprocess.run([sys.executable, "-c", script], stderr=end, timeout=300, check=True)
    os.close(end)
    drawn = os.read(terminal, 10_000)
    os.close(terminal)
    assert b"working" in drawn and b"100%" in drawn


def test_plot_crosses_flagged_readings_without_a_wider_axis(tmp_path):
    """One absurd reading must not flatten all others, nor look as reliable as they do."""
    from matplotlib.figure import Figure

    clear = Reading(0.2, "arm", 1, 4.0, 0.1, 40.0, 0.5)
    absurd = replace(clear, time_s=0.3, force_n=40.0, location_mm=75.0, flags=("weak",))
    axes = plot([clear, absurd, replace(clear, time_s=0.4)], axes=Figure().subplots(4, 1))
    for axis, largest in zip(axes[:2], (6.0, 45.0), strict=True):
        (crosses,) = [line for line in axis.get_lines() if line.get_label().startswith("flagged")]
        assert crosses.get_xdata().tolist() == [0.3] and axis.get_ylim()[1] < largest
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_readings([Reading(0.1, "arm"), Reading(0.2, "arm")], tmp_path / "out.png")


def test_command_in_a_test_does_what_its_process_does(tmp_path):
    """Most tests of the command start no process; they must find what a user's shell would."""
    same = {"sensors": [{"name": "arm", "model": "line-900mhz"}], "simulation": {"duration_s": 0.1}}
    found = []
    for run in (run_process, run_command):
        folder = tmp_path / run.__name__
        folder.mkdir()
        (folder / "same.yaml").write_text(json.dumps(same))
        done = run("simulate", "same.yaml", "x", cwd=folder)
        files = sorted(path.name for path in folder.iterdir())
        found.append((done.returncode, done.stdout, done.stderr, files))
    assert found[0] == found[1] and found[0][0] == 0


@pytest.mark.parametrize(
    ("flags", "kernels"),
    [("fpu sse2 avx2 fma", "Haswell"), ("fpu sse2 avx avx2", None), ("", None)],
)
def test_blas_settings_by_processor(tmp_path, flags, kernels):
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text(f"processor\t: 0\nflags\t\t: {flags}\n")
    chosen = blas_settings(cpuinfo, tmp_path / "numpy")
    assert chosen["OPENBLAS_NUM_THREADS"] == "1"
    assert chosen.get("OPENBLAS_CORETYPE") == kernels
    (tmp_path / "numpy.libs").mkdir()  # of a wheel
    assert blas_settings(cpuinfo, tmp_path / "numpy") == {"OPENBLAS_NUM_THREADS": "1"}


def test_command_uses_stated_kernels_of_blas():
    environment = {name: value for name, value in os.environ.items() if "OPENBLAS" not in name}
    command = [sys.executable, "-c", _ARCHITECTURE]
    used = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    stated, *kernels = used.stdout.split()
    assert stated == str(blas_settings().get("OPENBLAS_CORETYPE"))
    # None where NumPy has another library; its own choice where nothing is stated.
    assert kernels in (["Haswell"], []) or stated == "None"


_ARCHITECTURE = """
import os, wiforce_app, numpy, threadpoolctl
print(os.environ.get("OPENBLAS_CORETYPE"))
for library in threadpoolctl.threadpool_info():
    if library["internal_api"] == "openblas":
        print(library["architecture"])
"""
