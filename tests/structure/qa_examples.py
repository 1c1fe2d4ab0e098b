# SPDX-License-Identifier: GPL-3.0-or-later
"""Every example runs as shipped, without a screen, and its result is checked."""

import contextlib
import io
import json
import os
import re
import runpy
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import chain_simulated
import numpy as np
import pandas as pd
import pytest
import zmq
from chain_runs import Collector, assert_equal_readings
from gnuradio import blocks, wiforce
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.scene import load_capture_scene
from machine import wait_until
from modules import module_of

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FLOWGRAPHS = sorted(EXAMPLES.glob("*.grc"))
HEADLESS = EXAMPLES / "headless"
# Largest median error of readings after a slider was moved.
FORCE_LIMIT_N, LOCATION_LIMIT_MM = 0.15, 0.5


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder of the generated programs."""
    folder = tmp_path_factory.mktemp("generated")
    script = Path(__file__).parents[1] / "helpers/grc_compile.py"
    command = [sys.executable, str(script), str(folder), *map(str, FLOWGRAPHS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def generated(compiled, qt):
    """Import the generated module of a flowgraph by name."""

    def module(name):
        path = compiled / f"{name}.py"
        assert path.is_file()
        return module_of(path)

    return module


@pytest.mark.parametrize("path", FLOWGRAPHS, ids=lambda p: p.stem)
def test_flowgraph_compiles_and_is_documented(generated, path):
    assert hasattr(generated(path.stem), path.stem)
    listed = (EXAMPLES / "README.md").read_text()
    assert f"`{path.name}`" in listed
    assert f"`headless/{path.stem}.py`" in listed
    assert (HEADLESS / f"{path.stem}.py").is_file()


def test_flowgraph_without_its_usrp_ends_with_one_sentence(compiled):
    """Who runs it before the radio is connected would look for a fault in generated Python."""
    command = [sys.executable, compiled / "live_uhd.py"]
    command += ["--device", "type=usrp2,addr=127.255.255.254"]
    screenless = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(command, env=screenless, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    said = done.stderr.splitlines()
    assert sum(line.startswith("device: must be a USRP that answers (") for line in said) == 1


def test_record_uhd_states_its_scene(generated, monkeypatch, tmp_path):
    """Its recordings could not be read without the name of the scene."""
    source = blocks.vector_source_s([1, 2] * 1000, False, 2)
    monkeypatch.setattr(wiforce, "usrp", lambda **_: source)
    generated("record_uhd").record_uhd(recording=str(tmp_path / "air")).run()
    capture = open_capture(tmp_path / "air")
    assert load_capture_scene(capture).sensors == wiforce.load_scene("demo").sensors


def after(readings, time_s, sensor=None):
    return [r for r in readings if r["time_s"] > time_s and sensor in (None, r["sensor"])]


def settled(collector, flowgraph, tag, sensor=None):
    """The first eight readings that are determined by the latest settings only."""
    # Samples that the tag has not written yet follow the new settings.
    since = tag.nitems_written(0) / flowgraph.samp_rate
    margin = 2 * flowgraph.scene.group_period_s + 32768 / flowgraph.samp_rate
    collector.wait_for(lambda readings: len(after(readings, since + margin, sensor)) >= 8)
    return after(collector.readings, since + margin, sensor)[:8]


def assert_follows(readings, force_n, location_mm):
    """When a setting arrives is random, and with it how well a reading is known."""
    assert all(r.get("touch") == 1 for r in readings)
    force, force_std, location, location_std = (
        np.median([r[name] for r in readings])
        for name in ("force_n", "force_std_n", "location_mm", "location_std_mm")
    )
    assert force == pytest.approx(force_n, abs=FORCE_LIMIT_N + force_std)
    assert location == pytest.approx(location_mm, abs=LOCATION_LIMIT_MM + location_std)


@pytest.fixture
def running():
    """Start flowgraphs, and stop them at the end of the test."""
    started = []

    def start(flowgraph, reader=None):
        collector = Collector()
        if reader is not None:
            flowgraph.msg_connect(reader, "readings", collector, "readings")
        started.append((flowgraph, collector))
        flowgraph.start()
        return collector

    yield start
    for flowgraph, _ in started:
        flowgraph.stop()
        flowgraph.wait()


def untouched(flowgraph):
    return flowgraph.scene.reference_s + 3 * flowgraph.scene.group_period_s


def test_press_simulation_readings_follow_sliders_and_its_tare_button(generated, running, qt):
    flowgraph = generated("press_simulation").press_simulation()
    collector = running(flowgraph, flowgraph.reader)
    collector.wait_for(lambda readings: after(readings, untouched(flowgraph)))
    assert all(r.get("touch") == 0 for r in collector.readings)
    for force_n, location_mm in ((5.5, 47.5), (2.0, 55.0)):
        flowgraph.set_force_n(force_n)
        flowgraph.set_location_mm(location_mm)
        assert_follows(settled(collector, flowgraph, flowgraph.tag), force_n, location_mm)
    display = flowgraph.display.widget
    display._tare.click()
    refused = "tare refused: arm is touched"
    wait_until(lambda: refused in display._outcome.toolTip(), 60, meanwhile=display.refresh)
    flowgraph.set_clock_offset_ppm(20.0)
    assert_follows(settled(collector, flowgraph, flowgraph.tag), 2.0, 55.0)
    before = collector.readings[-1]["snr_db"]
    flowgraph.set_snr_db(10.0)
    # The noise estimate adapts within seconds.
    # The first groups of louder noise count as interference and have no values.
    collector.wait_for(lambda readings: readings[-1].get("snr_db", before) < before - 2.0)
    assert_follows(settled(collector, flowgraph, flowgraph.tag), 2.0, 55.0)
    flowgraph.set_force_n(0.0)
    assert all(r.get("touch") == 0 for r in settled(collector, flowgraph, flowgraph.tag))
    count = len(collector.readings)
    display._tare.click()
    collector.wait_for(lambda readings: any("reference" in r["flags"] for r in readings[count:]))
    wait_until(lambda: display.sensors() == ["arm"], 60, meanwhile=display.refresh)
    qt.processEvents()
    assert not flowgraph.grab().isNull()


def test_two_sensors_readings_are_independent(generated, running):
    flowgraph = generated("two_sensors").two_sensors()
    collector = running(flowgraph, flowgraph.reader)
    collector.wait_for(lambda readings: after(readings, untouched(flowgraph)))
    flowgraph.set_left_force_n(3.0)
    left = settled(collector, flowgraph, flowgraph.right, "left")
    assert_follows(left, 3.0, 33.0)
    right = after(collector.readings, 0, "right")
    assert all(r.get("touch") == 0 or r["flags"] for r in right)
    flowgraph.set_right_force_n(5.0)
    assert_follows(settled(collector, flowgraph, flowgraph.right, "right"), 5.0, 52.0)
    assert_follows(after(collector.readings, 0, "left")[-4:], 3.0, 33.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The name of a simulated recording of 3 s."""
    scene = wiforce.load_scene("tabletop").as_dict()
    scene["simulation"] |= {"duration_s": 3.0, "presses": scene["simulation"]["presses"][:1]}
    name = tmp_path_factory.mktemp("recording") / "press"
    wiforce.simulate(scene, name)
    return name


@pytest.fixture(scope="module")
def of_the_reader(recording, tmp_path_factory):
    """The file that the reader makes of the recording."""
    path = tmp_path_factory.mktemp("expected") / "readings.csv"
    headless("read_recording.py", recording, path, "tabletop")
    return path


def assert_equal_files(path, other):
    """Compare readings files: words exactly, numbers to the last digit that is written."""
    pd.testing.assert_frame_equal(pd.read_csv(path), pd.read_csv(other), rtol=0, atol=1.1e-4)


def test_headless_read_recording_writes_every_reading(recording, of_the_reader):
    read, truth = pd.read_csv(of_the_reader), pd.read_csv(f"{recording}.truth.csv")
    np.testing.assert_allclose(read["time_s"], truth["time_s"], atol=1e-5)
    touched = (read["touch"] == 1) & (truth["touch"] == 1)
    touched &= ~read["flags"].str.contains("transition", na=False)
    assert touched.sum() > 30
    for name, limit in (("force_n", FORCE_LIMIT_N), ("location_mm", LOCATION_LIMIT_MM)):
        assert (read[name] - truth[name])[touched].abs().median() < limit


def test_read_recording_writes_the_readings_of_the_reader(
    generated, recording, of_the_reader, tmp_path
):
    output = tmp_path / "readings.csv"
    flowgraph = generated("read_recording").read_recording(
        recording=str(recording), readings=str(output), scene="tabletop", speed=100.0
    )
    flowgraph.run()
    assert_equal_files(output, of_the_reader)
    flowgraph.display.widget.refresh()
    assert flowgraph.display.widget.sensors() == ["arm"]


def test_chain_simulated_shows_lines_clock_and_phases_of_both_estimators(generated, running):
    flowgraph = generated("chain_simulated").chain_simulated()
    collector = running(flowgraph, flowgraph.inversion)
    ours, paper = (block.widget for block in (flowgraph.phases, flowgraph.paper_phases))
    count = 40
    while min(len(plot.series(1)[1]) for plot in (ours, paper)) < count:
        threading.Event().wait(0.05)
    seconds = (count - 1) * flowgraph.scene.group_period_s
    for end, harmonic in enumerate((1, 4)):
        rotation = 360 * harmonic * flowgraph.scene.sensors[0].clock_hz * 40e-6 * seconds
        step = 0.15 * rotation + 1.0
        assert paper.series(end)[1][count - 1] == pytest.approx(rotation, abs=step)
        assert ours.series(end)[1][count - 1] == pytest.approx(0.0, abs=1.0)
    hertz, level_db = flowgraph.doppler.widget.series()
    for line_hz in (400, 1600):
        assert level_db[np.argmin(np.abs(hertz - line_hz))] > np.median(level_db) + 30
    # The tracker's standard deviation is well below 1 ppm here.
    assert flowgraph.clock_plot.widget.series(0)[1][-1] == pytest.approx(40.0, abs=2.0)
    flowgraph.set_force_n(4.0)
    assert_follows(settled(collector, flowgraph, flowgraph.tag), 4.0, 45.0)


def test_chain_from_file_writes_the_readings_of_the_reader(
    generated, recording, of_the_reader, tmp_path
):
    output = tmp_path / "readings.csv"
    flowgraph = generated("chain_from_file").chain_from_file(
        recording=f"{recording}.sigmf-data", readings=str(output), speed=100.0
    )
    flowgraph.run()
    assert_equal_files(output, of_the_reader)
    flowgraph.display.widget.refresh()
    assert flowgraph.display.widget.sensors() == ["arm"]
    assert len(flowgraph.phases.widget.series(0)[1]) == len(pd.read_csv(output))


def headless(script, *arguments):
    """What a script prints; run in this process, which has loaded GNU Radio already."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(sys, "argv", [script, *map(str, arguments)])
        try:
            runpy.run_path(str(HEADLESS / script), run_name="__main__")
        except SystemExit as ended:
            assert not ended.code, ended.code
    return printed.getvalue()


def test_headless_chain_from_file_writes_the_readings_of_the_reader(
    recording, of_the_reader, tmp_path
):
    headless("chain_from_file.py", recording, tmp_path / "out.csv")
    assert_equal_files(tmp_path / "out.csv", of_the_reader)


def test_chain_simulated_reads_as_the_reader_and_the_paper_does_not(capsys):
    scene, expected = wiforce.load_scene("tabletop"), []
    flowgraph = chain_simulated.ChainSimulated(scene)
    reader = wiforce.reader(scene, on_reading=expected.append)
    flowgraph.connect(flowgraph.simulated.tag, reader)
    flowgraph.run()
    flowgraph.chain.check()
    assert sum(reading.touch == 1 for reading in expected) > 40
    assert_equal_readings(flowgraph.readings, expected)
    assert len(flowgraph.readings_of_paper) == len(expected)
    capsys.readouterr()
    chain_simulated.print_spectrum(flowgraph, scene)
    chain_simulated.print_comparison(flowgraph)
    printed = capsys.readouterr().out
    found_ppm = float(printed.split("tag clock: ")[1].split()[0])
    assert found_ppm == pytest.approx(40.0, abs=2.0)
    forces = [float(value) for value in re.findall(r": +([.0-9]+) N at", printed)]
    assert forces[1::2] == pytest.approx([3.0, 5.5], abs=FORCE_LIMIT_N)
    assert abs(forces[0] - 3.0) > 1.0


def test_zmq_client_ends_quietly_when_its_output_is_closed():
    """Behind `| head` it ended with a traceback."""
    publisher = zmq.Context.instance().socket(zmq.PUB)
    port = publisher.bind_to_random_port("tcp://127.0.0.1")
    reading = {"touch": 1, "flags": "", "sensor": "arm", "force_n": 4.0, "location_mm": 45.0}
    text = json.dumps({"message": "reading", **reading})
    command = [sys.executable, HEADLESS / "zmq_client.py", f"tcp://127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as client:
        lines = []
        reader = threading.Thread(target=lambda: lines.append(client.stdout.readline()))
        reader.start()
        while reader.is_alive():
            publisher.send_string(text)
            reader.join(0.05)
        client.stdout.close()
        while client.poll() is None:
            publisher.send_string(text)
            time.sleep(0.05)
        assert client.stderr.read() == "" and client.returncode == -signal.SIGPIPE
    publisher.close(linger=0)
    assert lines == ["arm 4.0 N at 45.0 mm\n"]
