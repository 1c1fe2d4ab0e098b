# SPDX-License-Identifier: GPL-3.0-or-later
"""The examples with a USRP, run as shipped against the software one."""

import re
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import median

import pytest
from command_runs import succeeded
from live_runs import (
    FRAMES,
    SLOW,
    SLOW_GROUP_S,
    rows_of,
    scene_file,
    wait_until,
)
from software_usrp import SoftwareUsrp

SAMPLE_BYTES = 4  # sc16
EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A sensor that is pressed from 0.8 s on, at a low rate."""
    folder = tmp_path_factory.mktemp("pressed")
    return scene_file(folder, [(0.8, 4.0, 4.0, 45.0)], 400, 0.3, **SLOW)


@pytest.fixture(scope="module")
def device(scene):
    device = SoftwareUsrp(scene, speed=2)
    yield device
    device.stop()


README = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")


def test_readme_lines_replace_the_file_by_a_radio(device, scene):
    file, radio = (
        code
        for code in re.findall(r"```python\n(.*?)```", README, re.DOTALL)
        if "flowgraph" in code
    )
    *kept, replaced, run = file.splitlines()
    assert "file_source" in replaced
    program = "\n".join([*kept, radio, run]).replace("addr=192.168.10.2", f"{device.args},{FRAMES}")
    program = program.replace('"demo"', repr(str(scene)))
    # Shells let programs that they start in the background ignore the key.
    keys = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    with running("-u", "-c", keys + program) as process:
        wait_until(lambda: sum(" N at " in line for line in process.lines) > 20, process=process)
        process.send_signal(signal.SIGINT)
    assert process.returncode == 0
    assert all("arm: " in line for line in process.lines if " s " in line)


@contextmanager
def running(*words, **options):
    """A program that ends when its input does; what it prints goes to ``lines``."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, *map(str, words)], **pipes | options)
    process.lines = []
    reading = threading.Thread(target=lambda: process.lines.extend(process.stdout))
    reading.start()
    try:
        yield process
        if process.stdin is not None:
            with suppress(BrokenPipeError):  # ended before
                process.stdin.close()
        assert process.wait(timeout=300) == 0, process.lines
    finally:
        process.kill()
        reading.join()


def example(name, *arguments):
    return running(EXAMPLES / "headless" / name, *arguments)


def args_of(device):
    return f"{device.args},{FRAMES}"


def assert_pressed(lines):
    """Readings as printed: the press is among them, and read right."""
    pattern = r"[\d.]+ s arm: ([\d.]+) \+- [\d.]+ N at ([\d.]+) \+- [\d.]+ mm$"  # without flags
    pressed = [found for line in lines if (found := re.search(pattern, line.rstrip()))]
    assert len(pressed) > 5
    for number, true, limit in ((1, 4.0, 0.15), (2, 45.0, 0.5)):
        assert median(float(line[number]) for line in pressed) == pytest.approx(true, abs=limit)


@pytest.mark.parametrize("name", ["live_uhd.py", "chain_from_usrp.py"])
def test_example_prints_the_press(device, scene, name):
    with example(name, args_of(device), scene) as process:
        wait_until(lambda: len(process.lines) > 1.2 / SLOW_GROUP_S, process=process)
    assert_pressed(process.lines)


def test_example_record_uhd_recording_can_be_read(device, scene, tmp_path):
    samples, rate = tmp_path / "press.sigmf-data", SLOW["radio"]["sample_rate_hz"]
    enough = 1.3 * rate * SAMPLE_BYTES
    with example("record_uhd.py", args_of(device), scene, tmp_path / "press") as process:
        wait_until(lambda: samples.exists() and samples.stat().st_size > enough, process=process)
    succeeded("read", tmp_path / "press", "-o", tmp_path / "press.csv")
    rows = rows_of(tmp_path / "press.csv")
    assert len(rows) > 1.2 / SLOW_GROUP_S
    assert any(row["touch"] == "1" for row in rows)


def test_example_ended_by_ctrl_c_or_without_input_leaves_no_traceback(device, scene, tmp_path):
    """A service without input left an empty recording, which stood in the way of its next run."""
    command = [EXAMPLES / "headless/record_uhd.py", args_of(device), scene, tmp_path / "run"]
    for number in (None, signal.SIGINT, signal.SIGTERM):
        source = subprocess.DEVNULL if number is None else subprocess.PIPE
        with running("-u", *command, stdin=source, stderr=subprocess.STDOUT) as process:
            if number is not None:
                wait_until(
                    lambda lines=process.lines: any("to end" in line for line in lines),
                    process=process,
                )
                process.send_signal(number)
            process.wait(timeout=300)
        assert "Traceback" not in "".join(process.lines)
        left = sorted(path.suffix for path in tmp_path.iterdir())
        assert left in ([], [".sigmf-data", ".sigmf-meta"])
        for path in tmp_path.iterdir():
            assert path.stat().st_size > 0
            path.unlink()


def test_example_refuses_bad_input_in_a_sentence(device, scene, tmp_path):
    (tmp_path / "run.sigmf-data").write_text("precious")
    for words, said in (
        (["record_uhd.py", args_of(device), scene, tmp_path / "run"], "run.sigmf-data: exists al"),
        (["record_uhd.py"], "usage: record_uhd.py DEVICE SCENE RECORDING"),
        (["live_uhd.py", args_of(device), scene, "x", "y"], "gains: must be numbers, in dB, got"),
        (["transmit_uhd.py", "type=usrp2,addr=127.255.255.254", scene], "device: must be a USRP t"),
        (["press_simulation.py", "x"], "usage: press_simulation.py"),
    ):
        script, *arguments = words
        command = [sys.executable, EXAMPLES / "headless" / script, *arguments]
        done = subprocess.run(map(str, command), capture_output=True, text=True, timeout=300)
        assert done.returncode == 2 and said in done.stderr.splitlines()[-1], done.stderr
        assert "Traceback" not in done.stderr
    assert (tmp_path / "run.sigmf-data").read_text() == "precious"
