# SPDX-License-Identifier: GPL-3.0-or-later
"""The live reader against the software N210: presses, faults, and everything that ends a run."""

import csv
import json
import math
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zmq
from fuzzing import LIMIT_BYTES, peak_memory
from gnuradio.wiforce.estimation.frame import MARGIN
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.readings import GroupCounts
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from mutations import mutated
from software_usrp import SoftwareUsrp
from wiforce_app import watch
from wiforce_app.check import Findings, Sensor, advice_on

GROUP_S = 0.036
FRAMES = "recv_frame_size=8000,send_frame_size=8000"
GAINS = ["--tx-gain", "15", "--rx-gain", "15"]
KILLS, LONG_KILLS = 3, 100
REQUESTS, LONG_REQUESTS = 200, 10_000
FUZZED, LONG_FUZZED = 1, 100  # processes

# Rises, holds and falls, on both sides of the line's middle and between the model's locations.
PRESSES = [
    (0.9, 4.0, 6.0, 45.0), (2.3, 6.5, 3.0, 33.0), (3.7, 3.0, 3.0, 25.0), (5.1, 7.0, 7.0, 52.0),
    (6.5, 2.5, 5.0, 38.0), (7.9, 5.0, 5.0, 29.0), (9.3, 6.0, 4.0, 56.0), (10.7, 4.5, 4.5, 42.0),
    (12.1, 3.5, 6.5, 36.0), (13.5, 5.5, 5.5, 48.0),
]  # fmt: skip
CYCLE_S = 14.0  # after which they come again


# A fifth of the usual rate costs a fifth of the time, where the rate is not what is tested.
SLOW = {
    "radio": {"sample_rate_hz": 2.5e6},
    "sounding": {"frame_length": 400},
    "phase_group": {"snapshots": 200},
}
SLOW_GROUP_S = 200 * 400 / 2.5e6


def scene_of(presses, clock_hz=1000, reference_s=0.5, **sections):
    return {
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": clock_hz}],
        "reference_s": reference_s,
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": max((start for start, *_ in presses), default=0) + 5,
            "snr_db": 10,
            "static_clutter_db": 60,
            "clock_offset_ppm": 40,
            "presses": [
                {
                    "start_s": start,
                    "rise_s": 0.1,
                    "hold_s": 0.8,
                    "force_n": force,
                    "end_force_n": last,
                    "location_mm": place,
                }
                for start, force, last, place in presses
            ],
        },
        **sections,
    }


def scene_file(folder, *arguments, **options):
    path = folder / "scene.yaml"
    path.write_text(json.dumps(scene_of(*arguments, **options)))
    return path


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


def live_command(args, scene, *options):
    command = [sys.executable, "-m", "wiforce_app.main", "live", "--scene", str(scene)]
    return [*command, "--args", args, *map(str, options)]


@contextmanager
def live(args, scene, *options, limit=100, before=None):
    """A running live reader; ended if the test doesn't. ``before`` is called in it first."""
    process = subprocess.Popen(
        live_command(f"{args},{FRAMES}", scene, *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )
    timer = threading.Timer(limit, process.kill)
    timer.start()
    try:
        yield process
    finally:
        timer.cancel()
        process.kill()
        print(*process.communicate())  # shown when the test fails


def rows_of(path):
    with open(path, newline="") as stream:
        return list(csv.DictReader(stream))


def streaming_s(device):
    return device.command("status")["streaming_s"]


def wait_until(condition, limit=90):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.05)


class Readings:
    """Readings of a file beside what was pressed."""

    def __init__(self, path, scene):
        self.rows = rows_of(path)
        self.time_s = np.array([float(row["time_s"]) for row in self.rows])
        self.flags = [set(row["flags"].split()) for row in self.rows]
        truth = AirChannel(load_scene(scene)).touch_state(self.time_s)["arm"]
        self.touch = np.array([row["touch"] == "1" for row in self.rows])
        self.true_touch = truth.touch
        self.unflagged = np.array([not flags for flags in self.flags])
        self.force_error = self._column("force_n") - truth.force_n
        self.location_error = self._column("location_mm") - truth.location_mm
        self.force_std = self._column("force_std_n")
        self.location_std = self._column("location_std_mm")

    def _column(self, name):
        return np.array([float(row[name]) if row[name] else np.nan for row in self.rows])

    def check(self):
        """No unflagged reading is wrong, and the typical error is small."""
        assert np.array_equal(self.touch[self.unflagged], self.true_touch[self.unflagged])
        good = self.unflagged & self.touch
        assert good.sum() > 100
        assert np.median(np.abs(self.force_error[good])) <= 0.15
        assert np.median(np.abs(self.location_error[good])) <= 0.5
        # A group that lies in the middle of a rise reads its mean: half a newton at most.
        assert np.all(np.abs(self.force_error[good]) < 4 * self.force_std[good] + 0.5)
        assert np.all(np.abs(self.location_error[good]) < 4 * self.location_std[good] + 0.5)


class SideBySide:
    """Two readers on two devices at once, one of them with two faults every second.

    Attributes
    ----------
    clean, faulty : Readings
    said : list of str
        What either reader had to say.
    faults : int
    """

    def __init__(self, folder, seconds):
        cycles = range(math.ceil(seconds / CYCLE_S))
        presses = [(start + CYCLE_S * i, *rest) for i in cycles for start, *rest in PRESSES]
        presses = [press for press in presses if press[0] < seconds]
        scene = scene_file(folder, presses)
        faults = [f"+{second}.33 overflow 3630" for second in range(1, seconds)]
        faults += [f"+{second}.71 lose 2" for second in range(1, seconds)]
        self.faults = len(faults)
        devices = [SoftwareUsrp(scene), SoftwareUsrp(scene, faults=faults)]
        outputs = [folder / "clean.csv", folder / "faulty.csv"]
        options = [*GAINS, "--duration", seconds + 0.1, "-o"]
        try:
            running = [
                subprocess.Popen(
                    live_command(f"{device.args},{FRAMES}", scene, *options, output),
                    stderr=subprocess.PIPE,
                    text=True,
                )
                for device, output in zip(devices, outputs, strict=True)
            ]
            self.said = [process.communicate()[1] for process in running]
            assert [process.returncode for process in running] == [0, 0], self.said
        finally:
            for process in running:
                process.kill()
            for device in devices:
                device.stop()
        self.clean, self.faulty = (Readings(output, scene) for output in outputs)

    def check_clean(self, seconds):
        """Nothing is missing, and nothing wrong."""
        clean = self.clean
        assert clean.time_s[0] == GROUP_S / 2 and clean.time_s[-1] > seconds
        assert np.allclose(np.diff(clean.time_s), GROUP_S)
        assert not any("gap" in flags for flags in clean.flags)
        clean.check()
        assert self.said[0].count("\n") == 1 and "gaps" not in self.said[0]

    def check_faulty(self):
        """Faults cost no more than their groups; nothing restarts."""
        clean, faulty = self.clean, self.faulty
        faulty.check()
        flagged = sum("gap" in flags for flags in faulty.flags)
        assert self.faults / 2 <= flagged <= 2 * self.faults
        # Time goes on over the gaps, and the reference holds.
        assert np.allclose(np.diff(faulty.time_s), GROUP_S)
        assert sum("reference" in flags for flags in faulty.flags) <= 13
        others = [flags - {"gap"} for flags in faulty.flags[: len(clean.flags)]]
        different = sum(a != b for a, b in zip(others, clean.flags, strict=False))
        assert different <= 2 * self.faults
        assert "gaps" in self.said[1] and "samples lost" in self.said[1]


@pytest.fixture(scope="module")
def side_by_side(tmp_path_factory):
    return SideBySide(tmp_path_factory.mktemp("live"), 15)


@pytest.mark.timeout(600)
def test_presses_are_read_for_fifteen_seconds(side_by_side):
    side_by_side.check_clean(15)


@pytest.mark.timeout(600)
def test_overflows_and_losses_cost_no_more_than_their_groups(side_by_side):
    side_by_side.check_faulty()


def run_session(*arguments):
    """The last line that a run of session_runs.py prints, and what it says besides."""
    script = Path(__file__).with_name("session_runs.py")
    command = [sys.executable, str(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A short recorded run with an overflow: scene, recording, readings and when they came."""
    folder = tmp_path_factory.mktemp("recorded")
    scene = scene_file(folder, [(0.7, 4.0, 4.0, 45.0)], reference_s=0.3)
    device = SoftwareUsrp(scene, faults=["+1.0 overflow 45000"])
    try:
        readings, _ = run_session("timed", scene, f"{device.args},{FRAMES}", folder / "run", 1.4)
    finally:
        device.stop()
    return scene, folder / "run", readings


def test_an_onset_is_known_within_a_tenth_of_a_second(recorded):
    _, _, readings = recorded
    # The force rises from 0 to 4 N in 0.7 .. 0.8 s, and shorts the line from 0.9 N on. A group that
    # was cut by that tells of it by its flag.
    onset_s = 0.7 + 0.1 * 0.9 / 4
    told = next(row["came_s"] for row in readings if "transition" in row["flags"])
    assert 0.7 < told <= onset_s + 0.1
    touched = next(row["came_s"] for row in readings if row["touch"] == 1)
    assert touched <= onset_s + 0.15


def test_a_recording_reads_as_the_live_run_did(recorded, tmp_path):
    scene, capture, live_rows = recorded
    output = tmp_path / "read.csv"
    command = [sys.executable, "-m", "wiforce_app.main", "read", str(capture)]
    subprocess.run([*command, "--scene", str(scene), "-o", str(output)], check=True, timeout=60)
    read = rows_of(output)
    # The recorder may be a few samples ahead of the reader when the run is stopped.
    assert 0 <= len(read) - len(live_rows) <= 1
    assert len(live_rows) >= 38
    for ours, theirs in zip(live_rows[:-1], read, strict=False):
        assert float(theirs["time_s"]) == pytest.approx(ours["time_s"], abs=1e-9)
        assert theirs["flags"] == ours["flags"] and theirs["touch"] == str(ours["touch"])
        for name in ("phase1_deg", "phase2_deg"):
            assert float(theirs[name]) == pytest.approx(ours[name], abs=1e-3)


def test_a_recording_says_what_it_was_made_with_and_what_it_lost(recorded):
    scene, capture, _ = recorded
    opened = open_capture(capture)
    opened.check_against(load_scene(scene))
    assert len(opened.segments) == 2
    assert opened.span - opened.samples == 45000
    fields = json.loads(capture.with_name("run.sigmf-meta").read_text())["global"]
    assert "N210" in fields["core:hw"] and fields["core:datatype"] == "ci16_le"
    assert fields["wiforce:rx_gain_db"] == fields["wiforce:tx_gain_db"] == 15
    assert fields["wiforce:scene"]["sensors"][0]["name"] == "arm"


def test_killed_at_the_full_rate_it_leaves_all_but_the_last_second(software_usrp, tmp_path):
    scene = scene_file(tmp_path, PRESSES[:1])
    device = software_usrp(scene)
    output, name = tmp_path / "out.jsonl", tmp_path / "run"
    with live(device.args, scene, *GAINS, "-o", output, "--record", name) as process:
        wait_until(lambda: streaming_s(device) > 2.2)
        end_s = streaming_s(device)
        process.kill()
    times = [json.loads(line)["time_s"] for line in output.read_text().splitlines()]
    assert np.allclose(times, GROUP_S * (np.arange(len(times)) + 0.5))
    assert times[-1] > end_s - 1 - GROUP_S
    capture = open_capture(name)
    assert capture.samples / 12.5e6 > end_s - 1
    assert capture.sample_rate_hz == 12.5e6 and capture.center_frequency_hz == 900e6


def free_ports(count):
    """Ports that nobody listens at, now at least."""
    with ExitStack() as held:
        servers = [held.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [server.getsockname()[1] for server in servers]


@contextmanager
def connected(kind, port):
    """A ZMQ socket of this kind, connected to a reader's port."""
    with zmq.Context() as context, context.socket(kind) as client:
        client.setsockopt(zmq.LINGER, 0)
        client.setsockopt(zmq.RCVTIMEO, 60_000)
        client.connect(f"tcp://127.0.0.1:{port}")
        yield client


def ask(client, word):
    client.send_string(word)
    return json.loads(client.recv_string())


@pytest.mark.timeout(3000)
def test_killed_at_any_moment_it_leaves_all_but_the_last_second_and_hinders_no_rerun(
    slow_scene, slow_device, tmp_path, long_run
):
    rng = np.random.default_rng(11)
    output, (readings_port, control_port) = tmp_path / "out.jsonl", free_ports(2)
    options = [*GAINS, "-o", output, "--zmq", readings_port, "--control", control_port]

    def run_until(time_s, number, *more):
        """What had been received when the reader was ended, in seconds."""
        with (
            live(slow_device.args, slow_scene, *options, *more) as process,
            connected(zmq.REQ, control_port) as client,
        ):
            received_s = 0.0
            while received_s < time_s:
                received_s = ask(client, "status")["time_s"]
            if time_s < 0:
                time.sleep(-time_s)  # it starts, or not even that
            process.send_signal(number)
            process.communicate(timeout=60)
        assert process.returncode == (0 if number == signal.SIGTERM else -number)
        return received_s

    for kill in range(LONG_KILLS if long_run else KILLS):
        recording = tmp_path / f"run{kill}"
        output.unlink(missing_ok=True)
        received_s = run_until(rng.uniform(-2.0, 2.5), signal.SIGKILL, "--record", recording)
        lines = output.read_text().splitlines() if output.exists() else []
        times = [json.loads(line)["time_s"] for line in lines]
        assert np.allclose(times, SLOW_GROUP_S * (np.arange(len(times)) + 0.5))
        if received_s > 1:
            assert times[-1] > received_s - 1 - SLOW_GROUP_S
            capture = open_capture(recording)
            assert capture.samples / capture.sample_rate_hz > received_s - 1
            capture.check_against(load_scene(slow_scene))
    run_until(0.5, signal.SIGTERM)
    assert len(output.read_text().splitlines()) > 0.5 / SLOW_GROUP_S - 2


def test_readings_and_requests_go_over_zmq_and_clipping_is_told(slow_scene, slow_device, tmp_path):
    readings_port, control_port = free_ports(2)
    output = tmp_path / "out.csv"
    options = ["--zmq", readings_port, "--control", f"tcp://127.0.0.1:{control_port}", "-o", output]
    options += ["--tx-gain", 15, "--rx-gain", 20]
    with (
        live(slow_device.args, slow_scene, *options) as process,
        connected(zmq.SUB, readings_port) as subscriber,
        connected(zmq.REQ, control_port) as client,
    ):
        subscriber.subscribe("")

        def receive_until(last):
            rows = []
            while not (rows and last(rows[-1])):
                rows.append(json.loads(subscriber.recv_string()))
            return rows

        (first,) = receive_until(lambda row: True)
        assert first["sensor"] == "arm" and "saturated" in first["flags"].split()
        # Sample 0 of the stream lies some samples behind the common start of both directions.
        assert first["device_time_s"] - first["time_s"] > 0
        status = ask(client, "status")
        delay = (status["frame_offset"] + MARGIN) % 400
        assert status["ok"] and delay == pytest.approx(5.12 * 2.5 + 2, abs=2)
        assert status["clock_offset_ppm"][0] == pytest.approx(40, abs=4)
        assert ask(client, "tare") == {"ok": True}
        assert ask(client, "dance")["ok"] is False
        # The first reference ends at 0.3 s. The new one, then a touch against it.
        tared_s = ask(client, "status")["time_s"]
        later = receive_until(lambda row: row["time_s"] > tared_s + 0.6)
        assert any("reference" in row["flags"] for row in later if row["time_s"] > 0.35)
        assert "reference" not in later[-1]["flags"]
        slow_device.command("press arm 4.0 45.0")
        receive_until(lambda row: row["touch"] == 1)
        assert ask(client, "stop") == {"ok": True}
        _, said = process.communicate(timeout=60)
        assert process.returncode == 0
    assert "clips" in said
    assert rows_of(output)[-1]["touch"] == "1"


def test_a_full_disk_is_told_and_all_before_is_kept(slow_scene, slow_device, tmp_path):
    """First the recording meets its end, then the readings."""
    room = int(np.random.default_rng(2).integers(1000, 3000))

    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    output, recording = tmp_path / "out.csv", tmp_path / "run"
    options = [*GAINS, "-o", output, "--record", recording]
    with live(slow_device.args, slow_scene, *options, before=little_room) as process:
        _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    warning, error = said.splitlines()
    assert "not recorded further" in warning and "File too large" in warning
    assert error.startswith(f"gr-wiforce: {output}: cannot be written further")
    text = output.read_text()
    assert room - 100 < len(text) <= room and text.endswith("\n")
    assert np.allclose(np.diff([float(row["time_s"]) for row in rows_of(output)]), SLOW_GROUP_S)
    assert open_capture(recording).samples == room // 4
    assert not list(tmp_path.glob("*.part"))


def send_broken_requests(port, count, seed):
    """Sends so many, some in several parts, some too long; and a few from what speaks no ZMQ."""
    rng = np.random.default_rng(seed)
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", port)) as stranger:
            stranger.sendall(rng.bytes(200))
    with connected(zmq.DEALER, port) as client, connected(zmq.DEALER, port) as cut_off:
        while count > 0:
            burst = min(count, 500)  # below what a socket keeps
            answers = 0
            for number in range(burst):
                request = mutated(b"status tare", rng)
                if len(request) > 4096:
                    cut_off.send_multipart([b"", request])
                    continue
                client.send_multipart([b"", request, *[b"status"] * (number % 3)])
                answers += 1
            for _ in range(answers):
                answer = json.loads(client.recv_multipart()[-1])
                assert answer["ok"] or "must be one of" in answer["error"], answer
            count -= burst


@pytest.mark.timeout(3000)
def test_fuzzed_with_requests_it_reads_on_until_a_signal_and_writes_all_readings(
    slow_scene, slow_device, long_run
):
    """Many requests to the first process, then some to each of the others."""
    for process in range(LONG_FUZZED if long_run else FUZZED):
        count = LONG_REQUESTS if long_run and process == 0 else REQUESTS
        fuzz_with_requests(slow_scene, slow_device, count, seed=3 + process)


def fuzz_with_requests(scene, device, count, seed):
    (port,) = free_ports(1)
    with (
        live(device.args, scene, *GAINS, "--control", port, limit=900) as process,
        connected(zmq.REQ, port) as client,
    ):
        ask(client, "status")  # it listens
        send_broken_requests(port, count, seed)
        fuzzed_s = ask(client, "status")["time_s"]
        while ask(client, "status")["time_s"] < max(fuzzed_s, 0.5) + 0.3:
            pass
        peak = peak_memory(process.pid)
        process.send_signal(signal.SIGINT)
        output, said = process.communicate(timeout=60)
    assert process.returncode == 0 and said.startswith("gr-wiforce: read ")
    assert peak < LIMIT_BYTES
    read_s = float(said.split()[2])
    rows = list(csv.DictReader(output.splitlines()))
    assert abs(len(rows) - read_s / SLOW_GROUP_S) <= 2
    assert f"{len(rows)} groups: {sum(not row['flags'] for row in rows)} clear" in said


def test_a_device_that_vanishes_is_told_and_what_was_read_is_kept(
    software_usrp, slow_scene, tmp_path
):
    device = software_usrp(slow_scene)
    output = tmp_path / "out.csv"
    with live(device.args, slow_scene, *GAINS, "-o", output) as process:
        wait_until(lambda: streaming_s(device) > 1.0)
        device.process.kill()
        _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert said.count("\n") == 1 and "has sent nothing" in said and device.address in said
    assert len(rows_of(output)) > 15


def test_a_device_that_stalls_or_is_late_is_waited_for(software_usrp, slow_scene, tmp_path):
    """A second without a sample costs nothing, and a start that was missed is tried again; what
    came is recorded."""
    device = software_usrp(slow_scene, faults=["+0.8 stall 1.0"])
    script = Path(__file__).with_name("session_runs.py")
    command = [sys.executable, str(script), "told", str(slow_scene), f"{device.args},{FRAMES}"]
    command.append(str(tmp_path / "run"))
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "opened\n"
        for direction in ("rx", "tx"):
            device.command(f"fault 0 late {direction}")
        output, _ = process.communicate("start\n", timeout=100)
    assert process.returncode == 0
    told = json.loads(output.splitlines()[-1])
    status = device.command("status")
    assert status["faults"] == 3 and status["tx_late_packets"] > 0
    assert told["gaps"] == 0
    assert np.allclose(np.diff(told["time_s"]), SLOW_GROUP_S)
    assert told["time_s"][-1] > 1.2
    recorded = open_capture(tmp_path / "run")
    assert recorded.span == recorded.samples
    assert recorded.samples / 2.5e6 > told["time_s"][-1]


def command(*words):
    """Exit status, output and messages of a command."""
    done = subprocess.run(
        [sys.executable, "-m", "wiforce_app.main", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=100,
    )
    return done.returncode, done.stdout, done.stderr


def session_in_words():
    """What a Watch asks of a session."""
    return SimpleNamespace(
        gaps=0,
        samples_lost=0,
        frames_moved=0,
        times_ignored=0,
        samples_heard=0,
        time_s=1.0,
        recorder=None,
        alignment=SimpleNamespace(searches=0, offset=0),
        start_s=None,
        reader=SimpleNamespace(counts=GroupCounts()),
        latest=[],
    )


def test_times_that_may_be_off_are_told_and_no_loss_is_claimed(capsys):
    now = [0.0]
    session = session_in_words()
    looking = watch.Watch(session, "addr=1", now=lambda: now[0])
    cases = (
        (1, 0, ["frames came elsewhere once: times may be off by whole frames"]),
        (3, 1, ["frames came elsewhere 2 times: times", "a time that cannot be once"]),
        (3, 1, []),
    )
    for moved, ignored, told in cases:
        now[0] += 1.1
        session.frames_moved, session.times_ignored = moved, ignored
        looking.look()
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == len(told)
        assert all(words in line for words, line in zip(told, lines, strict=True))
        assert not any("lost" in line for line in lines)
    assert "frames came elsewhere 3 times" in looking.summary()
    assert "\n" not in looking.summary() and "lost" not in looking.summary()
    status = looking.status()
    assert (status["frames_moved"], status["times_ignored"]) == (3, 1)


@pytest.mark.parametrize("buffer, advised", [(212_992, True), (50_000_000, False)])
def test_a_machine_that_cannot_keep_up_is_told_what_may_help(
    buffer, advised, tmp_path, monkeypatch, capsys
):
    limit = tmp_path / "rmem_max"
    limit.write_text(f"{buffer}\n")
    monkeypatch.setattr(watch, "_BUFFER_LIMIT", limit)
    now = [0.0]
    session = session_in_words()
    looking = watch.Watch(session, "addr=1", now=lambda: now[0])
    for gaps, lost, told in ((1, 100, False), (7, 600, True)):
        now[0] += 1.1
        session.gaps, session.samples_lost = gaps, 100 * gaps
        looking.look()
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and f"{lost} samples lost" in said
        assert ("cannot keep up" in said) is told
        assert ("net.core.rmem_max" in said) is (told and advised)


@pytest.mark.parametrize("name", ["live", "check"])
def test_without_a_device_one_line_says_what_else_there_is(name):
    status, out, said = command(name, "--scene", "demo", "--args", "addr=127.0.0.254")
    assert (status, out) == (2, "") and said.count("\n") == 1
    assert all(word in said for word in ("addr=127.0.0.254", "emulate", "read"))


def test_what_the_device_cannot_do_is_told_in_one_line(software_usrp, tmp_path):
    device = software_usrp("--air", "cable")
    demo = ["--scene", "demo", "--args", device.args]
    odd_rate = scene_of([], radio={"sample_rate_hz": 11e6})
    (tmp_path / "rate.yaml").write_text(json.dumps(odd_rate))
    kept = [tmp_path / "run.sigmf-data", tmp_path / "kept.jsonl"]
    for path in kept:
        path.write_text("precious")
    demo_again = [*demo, "-o", kept[1]]
    taken = socket.create_server(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    cases = [
        (
            ["--scene", tmp_path / "rate.yaml", "--args", device.args],
            ["sample_rate_hz", "11000000"],
        ),
        ([*demo, "--rx-gain", 99], ["--rx-gain", "38"]),
        ([*demo, "--antenna", "J1"], ["--antenna", "RX2"]),
        ([*demo, "--reference", "sun"], ["--reference", "internal"]),
        ([*demo_again, "--record", tmp_path / "run"], ["run.sigmf-data", "exists"]),
        ([*demo_again, "--zmq", port], ["--zmq", "in use"]),
        ([*demo_again, "--control", port], ["--control", "in use"]),
        ([*demo, "-o", tmp_path / "out.txt"], ["out.txt", ".csv"]),
        ([*demo, "--zmq", "ipc://x"], ["--zmq"]),
        ([*demo, "--amplitude", 0.99], ["amplitude"]),
    ]
    # One process for all of them: starting it takes longer than what it does.
    with taken:
        requests = [json.dumps(case, default=str) for case, _ in cases]
        statuses, said = run_session("refused", *requests)
    assert statuses == [2] * len(cases)
    for line, (_, words) in zip(said.splitlines(), cases, strict=True):
        assert all(word in line for word in words), line
    assert all(path.read_text() == "precious" for path in kept)
    assert not list(tmp_path.glob("*.csv"))


def test_ten_starts_and_stops_leave_nothing_behind(slow_scene, slow_device):
    held, _ = run_session("repeated", slow_scene, f"{slow_device.args},{FRAMES}")
    assert held[1:] == held[:1] * 4


def test_a_check_finds_levels_delay_and_clock(slow_scene, slow_device):
    check = ["check", "--scene", slow_scene, "--args", f"{slow_device.args},{FRAMES}", "--json"]
    status, out, said = command(*check, *GAINS)
    assert (status, said) == (0, ""), said
    found = json.loads(out)
    # A scene on the air: peak 3 dB below full scale, noise by snr_db, 5.12 us of delay.
    channel = AirChannel(load_scene(slow_scene))
    assert found["levels"]["peak_dbfs"] == pytest.approx(-3, abs=1)
    noise_dbfs = 20 * np.log10(channel.noise_std)
    assert found["levels"]["noise_dbfs"] == pytest.approx(noise_dbfs, abs=0.3)
    assert found["levels"]["dc_dbfs"] < -90 and found["levels"]["clipped"] == 0
    assert found["delay_us"] == pytest.approx(5.12 + 2 * 0.4, abs=0.5)
    (arm,) = found["sensors"]
    assert arm["clock_offset_ppm"] == pytest.approx(40, abs=4)
    assert arm["snr_db"] == pytest.approx([10, 10], abs=1)
    assert max(arm["phase_error_deg"]) < 0.3
    assert found["advice"] == []
    # Far too little, and a tag that is off.
    slow_device.command("fault +0 off arm")
    status, out, _ = command(*check, "--tx-gain", 0, "--rx-gain", 0)
    advice = " ".join(json.loads(out)["advice"])
    assert status == 0 and "raise --rx-gain" in advice and "no tag heard" in advice


def test_a_check_tells_of_losses_that_only_the_frames_show(slow_scene):
    levels = {"peak_dbfs": -6.0, "clipped": 0.0, "dc_dbfs": -90.0}
    findings = Findings("a device", {}, levels, frames_moved=2, sensors=[Sensor("arm", 1.0)])
    (advice,) = advice_on(findings, load_scene(slow_scene))
    assert "frames came elsewhere 2 times" in advice
