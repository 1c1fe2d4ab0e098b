# SPDX-License-Identifier: GPL-3.0-or-later
"""The dialogue of `gr-wiforce calibrate --live` with a scripted person."""

import os
import re
import time

import pytest
from click.testing import CliRunner
from gnuradio.wiforce.calibration.gauges import ForceGauge
from gnuradio.wiforce.calibration.session import (
    CalibrationSession,
    SessionPlan,
    measure_press,
    measure_untouched,
)
from gnuradio.wiforce.sensor import load_sensor
from guided_presses import HandHeldSensor
from wiforce_app.calibrate.calibrate import calibrate
from wiforce_app.calibrate.dialogue import GuidedCalibration
from wiforce_app.calibrate.guide import OperatorLines

FORCES = (1.0, 2.0, 4.0, 6.0, 8.0)
PLAN = SessionPlan("arm", 900e6, (30.0, 50.0), FORCES)
_ASKED = re.compile(r"([\d.]+) mm, about ([\d.]+) N")


class Script:
    """Answers prompts: by the script first, then as a careful person would.

    ``answers``: what is typed at the prompts for a force, None at the end of input, or a function
    that returns it; ``types`` forces else; ``holds``: the sensor stays pressed at so many prompts
    to release it.
    """

    def __init__(self, sensor, answers=(), types=True, holds=0):
        self._sensor, self._answers = sensor, list(answers)
        self._types, self._holds = types, holds
        self.shown = ""

    def echo(self, text="", nl=True):
        self.shown += text + ("\n" if nl else "")

    def next(self, idle):
        idle()
        asked = _ASKED.fullmatch(self.shown.rsplit("\n", 1)[-1].split(" N:")[0] + " N")
        if asked is None:
            self._sensor.force_n = 3.0 if self._holds > 0 else 0.0
            self._holds -= 1
            return ""
        location_mm, force_n = map(float, asked.groups())
        self._sensor.force_n, self._sensor.location_mm = force_n, location_mm
        if not self._answers:
            return f"{force_n}" if self._types else ""
        answer = self._answers.pop(0)
        return answer() if callable(answer) else answer


@pytest.fixture
def sensor():
    return HandHeldSensor()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "arm.taps.csv"


def run(sensor, path, answers=(), scale=None, holds=0):
    """Whether the dialogue came to its end, what it showed, and the session's measurements."""
    script = Script(sensor, answers, scale is None, holds)
    session = CalibrationSession(PLAN, path)
    finished = GuidedCalibration(session, sensor, script, script.echo, scale).run()
    return finished, script.shown, session.measurements


def test_careful_person_is_led_to_a_complete_session(sensor, path):
    finished, shown, measurements = run(sensor, path)
    assert finished and "not stored" not in shown and "doubtful" not in shown
    assert [each.untouched for each in measurements] == 2 * [True, *5 * [False]]
    assert "10 of 10 measurements" in shown


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ("", "must be typed"),
        ("204", "force: must be 0.5 to 10 N (is it in g? 204 g are 2 N)"),
    ],
)
def test_wrong_entry_is_explained_and_asked_again(sensor, path, entry, reason):
    """One slip of the finger would spoil the sensor, or end an hour of work."""
    finished, shown, measurements = run(sensor, path, [entry])
    assert finished and shown.count("not stored") == 1 and reason in shown
    assert len(measurements) == 12


@pytest.mark.parametrize("end", ["q", None])
def test_quitting_keeps_everything_and_the_next_run_continues(sensor, path, end):
    """Typing q, or closing the terminal, would lose the session."""
    finished, shown, before = run(sensor, path, ["1", "2", "4", end])
    assert not finished and len(before) == 4
    finished, shown, after = run(sensor, path)
    assert finished and f"Presses stored in {path}: 3; the session continues" in shown
    # The sensor is released and measured untouched before the session continues.
    assert [each.force_n for each in after] == [0, 1, 2, 4, 0, 6, 8, 0, 1, 2, 4, 6, 8]


@pytest.mark.parametrize(
    ("answers", "said", "stored"),
    [
        (["1", "2", "u"], "removed: 2.00 N at 30 mm", [0, *FORCES, 0, *FORCES]),
        (["u"], "removed: the untouched sensor", [0, *FORCES, 0, *FORCES]),
        (["s", "2", "n"], "", [0, 2, 0, *FORCES]),
        (["1", "f"], "", [0, 1]),  # a sensor is made of what is stored
    ],
)
def test_undone_measurement_is_asked_for_again_and_skipped_ones_are_not(
    sensor, path, answers, said, stored
):
    finished, shown, measurements = run(sensor, path, answers)
    assert finished and said in shown
    assert [each.force_n for each in measurements] == stored


def test_location_left_early_does_not_cost_the_sensor(tmp_path, monkeypatch):
    """An hour of work at four locations would be refused for the fifth."""
    path, output = tmp_path / "arm.taps.csv", tmp_path / "arm.yaml"
    held = HandHeldSensor()
    session = CalibrationSession(SessionPlan("arm", 900e6), path)
    session.add(measure_untouched(held.readings(), 0.6))
    for location_mm in (20.0, 30.0, 40.0, 50.0, 60.0):
        for force_n in FORCES[: 2 if location_mm == 60 else 5]:
            held.location_mm, held.force_n = location_mm, force_n
            session.add(measure_press(held.readings(), location_mm, force_n, 0.6))
    monkeypatch.setattr("wiforce_app.calibrate.calibrate.guide", lambda *_: 900e6)
    command = [path, "-o", output, "--live", "--scene", "demo", "--args", "addr=127.0.0.1"]
    done = CliRunner().invoke(calibrate, list(map(str, command)))
    assert done.exit_code == 0, done.output
    assert load_sensor(output).location_span_mm == (20.0, 50.0)


def test_sensor_that_is_still_pressed_is_not_taken_as_untouched(sensor, path):
    finished, shown, measurements = run(sensor, path, holds=1)
    assert finished and len(measurements) == 12
    assert shown.count("must be released; a touch in 14 of 14 readings") == 1


class FakeScale:
    """A scale that shows what presses the sensor, until it stops sending."""

    def __init__(self, sensor):
        self.gauge = ForceGauge("scale", now_s=time.monotonic())
        self._sensor, self.sends = sensor, True

    def poll(self):
        if self.sends:
            self.gauge.note_force(time.monotonic(), self._sensor.force_n)


def test_scale_that_stops_sending_is_reported_and_waited_for(sensor, path, monkeypatch):
    """A force of some seconds ago would be stored with the phases of now."""
    monkeypatch.setattr("gnuradio.wiforce.calibration.gauges._SILENCE_S", 0.2)
    scale = FakeScale(sensor)

    def fall_silent():
        scale.sends = False
        return ""

    def plug_in_again():
        scale.sends = True
        scale.poll()
        return ""

    answers = ["", fall_silent, plug_in_again]
    finished, shown, measurements = run(sensor, path, answers, scale)
    assert finished and "press Enter" in shown
    assert shown.count("scale: has sent no force for") == 1
    assert [each.force_n for each in measurements[1:6]] == [1, 2, 4, 6, 8]


def test_lines_are_read_while_other_work_goes_on():
    reading, writing = os.pipe()
    lines, calls = OperatorLines(reading), []
    os.write(writing, b"2.5\r\nq")
    assert lines.next(lambda: calls.append(1)) == "2.5"

    def close():
        calls.append(1)
        if len(calls) == 3:
            os.close(writing)

    assert lines.next(close) == "q" and len(calls) >= 3
    assert lines.next(lambda: None) is None
    os.close(reading)
