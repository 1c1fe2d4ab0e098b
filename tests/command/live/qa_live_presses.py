# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses read live, with and without lost samples, and from the recording of the run."""

import json
import math
import subprocess

import numpy as np
import pytest
from command_runs import succeeded
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.readings import parsed_utc
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from live_runs import (
    FRAMES,
    GAINS,
    SLOW,
    SLOW_GROUP_S,
    live_command,
    rows_of,
    scene_file,
)
from software_usrp import SoftwareUsrp

SECONDS, LONG_SECONDS = 3, 180
FULL_RATE_GROUP_S = 0.036
SPEED = 3  # the low rate takes a fifth of the time of the full one

# Rises, holds and falls, on both sides of the line's middle and between the model's locations.
PRESSES = [
    (0.9, 4.0, 6.0, 45.0), (2.3, 6.5, 3.0, 33.0), (3.7, 3.0, 3.0, 25.0), (5.1, 7.0, 7.0, 52.0),
    (6.5, 2.5, 5.0, 38.0), (7.9, 5.0, 5.0, 29.0), (9.3, 6.0, 4.0, 56.0), (10.7, 4.5, 4.5, 42.0),
    (12.1, 3.5, 6.5, 36.0), (13.5, 5.5, 5.5, 48.0),
]  # fmt: skip
CYCLE_S = 14.0  # after which they come again


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

    def check(self, least):
        """No unflagged reading is wrong, and the typical error is small."""
        assert np.array_equal(self.touch[self.unflagged], self.true_touch[self.unflagged])
        good = self.unflagged & self.touch
        assert good.sum() > least
        assert np.median(np.abs(self.force_error[good])) <= 0.15
        assert np.median(np.abs(self.location_error[good])) <= 0.5
        # A group that lies in the middle of a rise reads its mean: half a newton at most.
        assert np.all(np.abs(self.force_error[good]) < 4 * self.force_std[good] + 0.5)
        assert np.all(np.abs(self.location_error[good]) < 4 * self.location_std[good] + 0.5)


class SideBySide:
    """Two readers on two devices at once, one of them with two faults every second.

    ``full_rate``: 12.5 Msps instead of 2.5 Msps. ``said``: what either reader had to say.
    """

    def __init__(self, folder, seconds, full_rate):
        self.seconds = seconds
        self.group_s = FULL_RATE_GROUP_S if full_rate else SLOW_GROUP_S
        cycles = range(math.ceil(seconds / CYCLE_S))
        presses = [(start + CYCLE_S * i, *rest) for i in cycles for start, *rest in PRESSES]
        presses = [press for press in presses if press[0] < seconds]
        scene = (
            scene_file(folder, presses)
            if full_rate
            else scene_file(folder, presses, clock_hz=400, **SLOW)
        )
        overflow = 3630 if full_rate else 726
        faults = [f"+{second}.33 overflow {overflow}" for second in range(1, seconds)]
        faults += [f"+{second}.71 lose 2" for second in range(1, seconds)]
        self.faults = len(faults)
        speed = 1 if full_rate else SPEED
        devices = [SoftwareUsrp(scene, speed=speed, faults=each) for each in ((), faults)]
        self.scene, self.recording = scene, folder / "run"
        outputs = [folder / "clean.csv", folder / "faulty.csv"]
        options = [*GAINS, "--duration", seconds + 0.1]
        more = [[], [] if full_rate else ["--record", self.recording]]
        try:
            running = [
                subprocess.Popen(
                    live_command(f"{device.args},{FRAMES}", scene, *options, *own, "-o", output),
                    stderr=subprocess.PIPE,
                    text=True,
                )
                for device, own, output in zip(devices, more, outputs, strict=True)
            ]
            self.said = [process.communicate()[1] for process in running]
            assert [process.returncode for process in running] == [0, 0], self.said
        finally:
            for process in running:
                process.kill()
            for device in devices:
                device.stop()
        self.clean, self.faulty = (Readings(output, scene) for output in outputs)

    def check_clean(self):
        """Nothing is missing, and nothing wrong."""
        clean = self.clean
        assert clean.time_s[0] == self.group_s / 2 and clean.time_s[-1] > self.seconds
        assert np.allclose(np.diff(clean.time_s), self.group_s)
        assert not any("gap" in flags for flags in clean.flags)
        clean.check(10 * self.seconds)
        # When anybody may press, and the summary; a busy machine may miss when nobody may, and
        # send too late.
        said = [line for line in self.said[0].splitlines() if "transmit underflow" not in line]
        *_, may_be_pressed, summary = said
        assert "may be pressed" in may_be_pressed and "gaps" not in summary
        assert len(said) <= 3

    def check_faulty(self):
        """Faults cost no more than their groups; nothing restarts."""
        clean, faulty = self.clean, self.faulty
        faulty.check(6 * self.seconds)
        flagged = sum("gap" in flags for flags in faulty.flags)
        assert self.faults / 2 <= flagged <= 2 * self.faults
        # Time goes on over the gaps, and the reference holds.
        assert np.allclose(np.diff(faulty.time_s), self.group_s)
        assert sum("reference" in flags for flags in faulty.flags) <= 0.5 / self.group_s
        others = [flags - {"gap"} for flags in faulty.flags[: len(clean.flags)]]
        different = sum(a != b for a, b in zip(others, clean.flags, strict=False))
        assert different <= 2 * self.faults
        assert "gaps" in self.said[1] and "samples lost" in self.said[1]


@pytest.fixture(scope="module")
def side_by_side(tmp_path_factory, long_run):
    folder = tmp_path_factory.mktemp("live")
    return SideBySide(folder, LONG_SECONDS if long_run else SECONDS, full_rate=long_run)


@pytest.mark.timeout(3000)
def test_live_presses_read_within_their_errors(side_by_side):
    """A user would not know that a live reading can be as wrong as a guess."""
    side_by_side.check_clean()


@pytest.mark.timeout(3000)
def test_live_overflows_and_lost_packets_flag_their_groups_only(side_by_side):
    """A user would lose the reference, or seconds of readings, with every overflow."""
    side_by_side.check_faulty()


@pytest.mark.timeout(3000)
def test_live_recording_reads_as_the_live_run_and_names_device_gains_and_losses(
    side_by_side, tmp_path
):
    """A run could not be read again with other settings."""
    if not side_by_side.recording.with_suffix(".sigmf-meta").exists():
        pytest.skip("minutes at the full rate would take gigabytes")
    capture, scene = side_by_side.recording, side_by_side.scene
    output = tmp_path / "read.csv"
    succeeded("read", capture, "--scene", scene, "-o", output)
    read, live_rows = rows_of(output), side_by_side.faulty.rows
    # The recorder may be a few samples ahead of the reader when the run is stopped.
    assert 0 <= len(read) - len(live_rows) <= 1
    for ours, theirs in zip(live_rows[:-1], read, strict=False):
        for name in ("time_s", "flags", "touch"):
            assert theirs[name] == ours[name]
        for name in ("phase1_deg", "phase2_deg"):
            assert float(theirs[name] or 0) == pytest.approx(float(ours[name] or 0), abs=1e-3)
    opened = open_capture(capture)
    opened.check_against(load_scene(scene))
    assert len(opened.segments) == side_by_side.faults + 1
    metadata = json.loads(capture.with_name("run.sigmf-meta").read_text())
    fields, begins = metadata["global"], metadata["captures"][0]["core:datetime"]
    first_s = parsed_utc(live_rows[0]["time_utc"]).timestamp() - float(live_rows[0]["time_s"])
    assert parsed_utc(begins).timestamp() == pytest.approx(first_s, abs=0.01)
    assert "N210" in fields["core:hw"] and fields["core:datatype"] == "ci16_le"
    assert fields["wiforce:rx_gain_db"] == fields["wiforce:tx_gain_db"] == 15
    assert fields["wiforce:scene"]["sensors"][0]["name"] == "arm"
