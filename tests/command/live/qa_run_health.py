# SPDX-License-Identifier: GPL-3.0-or-later
"""State, log lines and times of a live run, from what a session reports alone."""

from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from gnuradio.wiforce.io.readings import GroupCounts, Reading
from gnuradio.wiforce.press.evidence import Suspicion
from gnuradio.wiforce.press.tares import TareState
from wiforce_app.live.clients import problems_of
from wiforce_app.live.health import RunHealth
from wiforce_app.live.radio_keeper import OPENING, RECONNECTING, RUNNING, STOPPING
from wiforce_app.live.run import TareLog
from wiforce_app.radio.streams import ClockComparison


class Run:
    """A session of which a test says what it is in."""

    def __init__(self):
        self.now_s, self.heard_s, self.said = 0.0, 0.0, []
        self.problem, self.device, self.suspicions = "", RUNNING, []
        tares = SimpleNamespace(measuring=False, state=TareState())
        sensor = SimpleNamespace(name="arm", model=SimpleNamespace(length_mm=80.0))
        self.stream = SimpleNamespace(
            state="reading",
            tares=tares,
            reference_problem=lambda name: self.problem,
            suspicions=lambda: {"arm": self.suspicions},
            plan=SimpleNamespace(
                reference_groups=10,
                group_period_s=0.05,
                sensors=[sensor],
                skin=None,
                require_scene=lambda: SimpleNamespace(path=Path("arm_scene.yaml")),
            ),
        )
        self.cancelled = []
        self.session = SimpleNamespace(
            source=self,
            start_s=100.0,
            clock=(980.0, 0.002),
            time_s=1.0,
            fold=SimpleNamespace(gaps=lambda: 0, samples_lost=lambda: 0),
            clock_offsets_ppm={"arm": 40.1},
            alignment=SimpleNamespace(offset=0),
            reader=SimpleNamespace(
                stream=self.stream, counts=GroupCounts(), cancel_tare=self.cancelled.append
            ),
        )
        self.health = RunHealth(
            "20260101T000000Z-abcdef",
            self.session,
            self.said.append,
            device_state=lambda: self.device,
            now=lambda: self.now_s,
        )

    @property
    def idle_s(self):
        return self.now_s - self.heard_s

    def read(self, seconds, touch=0, flags=()):
        """Receive for so long, in steps of 0.1 s."""
        for _ in range(round(10 * seconds)):
            self.now_s += 0.1
            self.heard_s = self.now_s
            reading = Reading(round(self.now_s, 3), "arm", touch, flags=flags)
            self.session.reader.counts.note([reading])
            self.health.note(reading)
            self.health.look()
        return self.health.state


@pytest.fixture
def run():
    return Run()


@pytest.mark.parametrize(
    "problem, words",
    [
        ("", "readings continue from the former reference"),
        ("it moved", "it moved: readings are flagged until a tare"),
    ],
)
def test_health_says_when_a_tag_goes_silent_and_returns(run, problem, words):
    assert run.read(2.0) == ("reading", "")
    assert run.read(0.9, touch=None)[0] == "reading"
    assert not run.said
    assert run.read(2.0, touch=None) == ("lost", "not received: arm")
    assert run.said == ["arm is not received since 2.00 s; its readings are empty until it returns"]
    assert run.health.report()["sensors"]["arm"]["age_s"] == pytest.approx(2.9)
    run.problem = problem
    assert run.read(0.1)[0] == "reading"
    assert run.said[1].startswith("arm is received again at 5.00 s, after 3.0 s; ")
    assert words in run.said[1] and len(run.said) == 2


def test_health_says_rarely_of_a_tag_that_comes_and_goes(run):
    """The journal got a line every second, for days."""
    for _ in range(60):
        run.read(0.5)
        run.read(1.5, touch=None)
    assert len(run.said) == 7


def test_health_names_a_suspicion_once(run):
    """The numbers in it change with every press."""
    run.suspicions = [Suspicion("off state", "the amplitude changes by 4 %")]
    run.read(0.3)
    run.suspicions = [Suspicion("off state", "by 5 %"), Suspicion("swapped ends", "swapped")]
    run.read(0.3)
    assert run.said == ["arm: the amplitude changes by 4 %", "arm: swapped"]


def test_health_says_when_a_tag_appears_after_its_reference(run):
    run.read(2.0, touch=None)
    run.read(0.5)
    assert len(run.said) == 2 and "flagged inconsistent until a tare" in run.said[1]


def test_health_without_samples_or_device_is_waiting_and_later_lost(run):
    run.device, run.session.alignment.offset = OPENING, None
    assert run.health.state == ("waiting", "the device is not open yet")
    run.device = RUNNING
    assert run.health.state == ("waiting", "no sounding frames yet")
    run.now_s = 1.5
    assert run.health.state == ("waiting", "no samples")
    run.session.alignment.offset = 3
    assert run.read(0.5)[0] == "reading"
    run.now_s += 2.0
    assert run.health.state == ("lost", "no samples for 2.0 s")
    assert run.read(0.5)[0] == "reading"
    run.device = RECONNECTING
    assert run.health.state == ("lost", "the device is lost, and sought again")
    run.device = STOPPING
    assert run.health.state == ("ending", "")
    run.device = RUNNING
    assert run.read(0.5)[0] == "reading"


def test_health_gives_up_a_tare_that_gets_no_groups(run):
    """The reply to its request would never come otherwise."""
    run.stream.tares.measuring = True
    run.stream.tares.state = TareState("measuring", time_s=1.0)
    run.session.time_s = 3.4
    run.read(0.1)
    assert not run.cancelled
    run.session.time_s = 3.6
    run.read(0.1)
    assert run.cancelled == ["no groups are received; the former reference is kept"]


def test_health_stamps_readings_with_run_and_utc(run):
    run.read(0.1)
    stamp = run.health.stamp(Reading(2.5, "arm"))
    # Device time 102.5 s; the host's 1000 s are the device's 20 s.
    assert (stamp["run"], stamp["device_time_s"]) == (run.health.run, 102.5)
    assert stamp["time_utc"] == "1970-01-01T00:18:02.500000Z"
    assert run.health.report()["time_utc_uncertainty_s"] == 0.002
    run.session.clock = None  # the next device has not sent samples yet
    assert run.health.stamp(Reading(2.5, "arm")) == stamp
    run.session.clock = (981.0, 0.001)
    assert run.health.stamp(Reading(2.5, "arm"))["time_utc"] == "1970-01-01T00:18:03.500000Z"


def test_clock_comparison_takes_the_quickest_answer_and_follows_the_host():
    times, steady = iter([0.0, 0.4, 1.0, 1.1, 2.0, 2.6, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0]), [0.0]
    clocks = ClockComparison(lambda: 7.0, utc=lambda: next(times), now=lambda: steady[0])
    assert clocks.look() == pytest.approx((1.05 - 7.0, 0.05))
    steady[0] = 9.0
    assert clocks.look() is None
    steady[0] = 10.0
    assert clocks.look() == pytest.approx((50.0 - 7.0, 0.0))
    no_answer = Mock(side_effect=RuntimeError("no control response"))
    assert ClockComparison(no_answer).look() is None


@pytest.mark.parametrize(
    "change, problem",
    [
        ({}, None),
        ({"state": "lost", "reason": "no samples for 2.0 s"}, "state: lost (no samples for 2.0 s)"),
        ({"age_s": 2.1}, "arm: last reading 2.1 s ago"),
        ({"age_s": None}, "arm: no reading yet"),
        ({"reference_problem": "it moved"}, "arm: it moved"),
    ],
)
def test_status_names_what_is_wrong(change, problem):
    sensor = {"age_s": 0.1, "received": True, "reference_problem": ""}
    answer = {"state": "reading", "reason": "", "sensors": {"arm": sensor}}
    (sensor if change.keys() & sensor.keys() else answer).update(change)
    assert problems_of(answer, 2.0) == ([] if problem is None else [problem])


def test_tag_lost_device_is_not_reported_as_a_silent_tag():
    """The operator would look for the fault at the tag."""
    run = Run()
    run.read(2.0)
    for step in range(50):
        run.health.note(Reading(round(run.now_s + 0.1 * step, 3), "arm", flags=("gap",)))
    run.now_s += 5.0
    run.read(0.5, touch=None)  # clocks are sought
    assert run.said == []
    run.read(0.6, touch=None)
    assert run.said == ["arm is not received since 2.00 s; its readings are empty until it returns"]


def test_tare_log_flood_of_requests_writes_few_lines_and_answers_all():
    """Each of 2000 requests wrote a line of the journal."""
    said, answered, waiting, now_s = [], [], [], 0.0
    session = SimpleNamespace(reader=SimpleNamespace(tare=lambda force, done: waiting.append(done)))
    tares = TareLog(session, said.append, now=lambda: now_s)
    for _ in range(20):
        now_s += 0.01
        tares.request(True, answered.append)
        waiting.pop()(TareState("complete", forced=True))
    assert len(answered) == 20 and said == ["tare complete (forced)"]
    tares.request(False)
    waiting.pop()(TareState("refused", "arm is touched"))
    assert said[1:] == ["tare refused: arm is touched"]
