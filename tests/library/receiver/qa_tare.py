# SPDX-License-Identifier: GPL-3.0-or-later
"""A new untouched reference on request: refused, failed or forced, and the readings after it."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.press.sensor_state import SensorState
from gnuradio.wiforce.receiver import Receiver
from long_cases import cases
from plain import WAVEFORM
from sequence_readings import AsSeparated

K = len(WAVEFORM.bins)
STD_DEG = 0.1


class Bench:
    """A receiver of sensors that a test presses, moves and switches off, group by group."""

    def __init__(self, sensors=1, seed=1, reference=()):
        scene = {
            "sensors": [
                {"name": f"s{i}", "model": "line-900mhz", "clock_hz": 1000 + 400 * i}
                for i in range(sensors)
            ]
        }
        self.plan = wiforce.plan(scene)
        self.receiver = Receiver(self.plan)
        self.receiver.separation = AsSeparated()
        self.states = []
        self.receiver.tares.on_state = self.states.append
        self._rng = np.random.default_rng(seed)
        delays = np.linspace(0.02, 0.06, 2 * sensors)
        self._channel = np.exp(-2j * np.pi * np.outer(delays, WAVEFORM.subcarriers / 5.12))
        self._variance = 2 * K * np.radians(STD_DEG) ** 2
        self._model = self.plan.sensors[0].model
        self.truth, self.readings, self._index = [], [], 0
        length = self.plan.reference_groups
        for press in reference:
            self.run(length // len(reference), press)
        self.run(length - self._index + 3, *reference[-1:])

    def run(self, groups, *presses, turned_deg=0.0, silent=(), retuned=False):
        """Receive groups; a press (force, location) or None for each sensor."""
        presses = presses or [None] * len(self.plan.sensors)
        for _ in range(groups):
            psi = [
                self._model.untouched_deg() if press is None else self._model.phases_deg(*press)
                for press in presses
            ]
            turns = np.radians(np.ravel(psi) + turned_deg)[:, None]
            noise = self._rng.standard_normal((2, *self._channel.shape))
            noise = (noise[0] + 1j * noise[1]) * np.sqrt(self._variance / 2)
            on = np.array([i not in silent for i in range(len(presses))])
            self._receive(self._channel * np.exp(1j * turns) + noise, on, retuned)
            retuned = False
            self.truth += presses
        return self

    def _receive(self, ends, on, retuned):
        sensors = len(on)
        group = Groups(
            [self._index],
            np.zeros((1, len(self.plan.table.tones), K)),
            ends=ends[None],
            gain=np.where(np.repeat(on, 2), 1.0, np.inf)[None],
            noise=np.full((1, K), self._variance),
            snr_db=np.full((1, 2 * sensors), 10.0),
            locked=on[None],
            overlapping=np.zeros((1, sensors), bool),
            retuned=np.array([retuned]),
        )
        self._index += 1
        self.readings += self.receiver.process(group)

    def finished(self, sensor=0):
        """Pairs of truth and reading of a sensor."""
        self.readings += self.receiver.finish()
        step = len(self.plan.sensors)
        return list(zip(self.truth[sensor::step], self.readings[sensor::step], strict=True))


def is_right(press, reading):
    """Whether a reading without a flag is what it says."""
    if reading.touch is None:
        return False
    if press is None or not reading.touch:
        return press is None and not reading.touch
    return abs(reading.force_n - press[0]) < max(0.2, 5 * reading.force_std_n)


def wrong(pairs):
    return [i for i, (press, r) in enumerate(pairs) if not r.flags and not is_right(press, r)]


def test_tare_during_a_press_is_refused_and_the_press_is_still_read():
    bench = Bench().run(8, (5.0, 40.0))
    state = bench.receiver.tare()
    assert state.state == "refused" and "s0 is touched (5.0" in state.reason
    pairs = bench.run(30, (5.0, 40.0)).finished()
    assert not wrong(pairs) and all(r.touch == 1 for _, r in pairs[-30:])


def test_tare_of_a_sensor_in_doubt_is_refused(monkeypatch):
    bench = Bench()
    monkeypatch.setattr(SensorState, "problem", "nobody knows")
    state = bench.receiver.tare()
    assert state.state == "refused"
    assert state.reason.startswith("s0 may be touched: nobody knows; release it")


@pytest.mark.parametrize("location_mm", [20.0, 40.0, 60.0])
@pytest.mark.parametrize("after", [1, 6, 12])
def test_tare_that_a_press_begins_in_fails_and_keeps_the_reference(location_mm, after):
    """At mid-line both phases change alike, as when the tag moves."""
    bench = Bench()
    assert bench.receiver.tare().state == "measuring"
    bench.run(after).run(30, (5.0, location_mm))
    assert [s.state for s in bench.states] == ["measuring", "failed"]
    assert "s0 was touched at" in bench.states[-1].reason
    pairs = bench.run(20).finished()
    assert not wrong(pairs)
    clear = [r for press, r in pairs if press and not r.flags]
    assert len(clear) > 15 and all(r.touch == 1 for r in clear)


def test_tare_that_the_tag_moves_in_changes_no_reading():
    """What the reference holds is compared with the former one: the untouched phases are known."""
    bench = Bench()
    bench.receiver.tare()
    bench.run(6).run(20, turned_deg=25.0)
    assert bench.states[-1].state == "complete"
    pairs = bench.run(20, (4.0, 30.0), turned_deg=25.0).run(5, turned_deg=25.0).finished()
    assert not wrong(pairs) and sum(not r.flags for _, r in pairs[-24:-6]) > 14


def test_tare_after_the_device_was_opened_again_is_not_judged_by_the_former_reference():
    """Its oscillators have other phases, which may look like a touch: no tare would be accepted."""
    alike = (5.0, 40.0)
    bench = Bench().run(8).run(10, alike, retuned=True)
    assert bench.receiver.tare().state == "measuring"
    later = bench.plan.reference_groups + 10
    bench.run(later, alike)
    assert bench.states[-1].state == "complete"
    readings = [reading for _, reading in bench.finished()]
    assert all(reading.touch == 0 and not reading.flags for reading in readings[-5:])
    assert all("moved" in reading.flags for reading in readings[-later - 10 : -later])


@pytest.mark.parametrize(
    ("force", "before", "groups", "meanwhile", "reason"),
    [
        (True, 6, 4, {"turned_deg": 70.0, "retuned": True}, "opened or tuned again"),
        (False, 0, 20, {"silent": [0]}, "no sensor"),
        (False, 3, 20, {"silent": [0]}, "in 3 of 13"),
    ],
)
def test_tare_fails_when_its_groups_are_not_of_one_sensor(force, before, groups, meanwhile, reason):
    bench = Bench()
    bench.receiver.tare(force=force)
    bench.run(before).run(groups, None, **meanwhile)
    assert bench.states[-1].state == "failed" and reason in bench.states[-1].reason


def test_tare_of_an_untouched_sensor_is_complete_after_the_reference():
    bench = Bench()
    bench.run(100, turned_deg=3.0)
    bench.receiver.tare()
    bench.run(bench.plan.reference_groups - 1, turned_deg=3.0)
    assert bench.receiver.tares.measuring and bench.receiver.state == "reference"
    bench.run(1, turned_deg=3.0)
    assert bench.states[-1].state == "complete" and bench.receiver.state == "reading"
    pairs = bench.run(20, (4.0, 30.0), turned_deg=3.0).run(9, turned_deg=3.0).finished()
    assert not wrong(pairs) and sum("reference" in r.flags for _, r in pairs) == 26


@pytest.mark.parametrize("force_n, location_mm", [(2.0, 20.0), (5.0, 40.0), (7.0, 66.0)])
def test_tare_forced_during_a_press_is_doubted_until_the_release(force_n, location_mm):
    bench = Bench().run(8, (force_n, location_mm))
    assert bench.receiver.tare(force=True).state == "measuring"
    bench.run(20, (force_n, location_mm))
    assert bench.states[-1].state == "complete" and bench.states[-1].forced
    assert "touched" in bench.receiver.tare().reason
    bench.run(20).run(20, (4.0, 35.0)).run(8)
    pairs = bench.finished()
    assert not wrong(pairs)
    assert all("ambiguous" in r.flags for _, r in pairs[37:42])
    pressed = [r for press, r in pairs[-28:-8] if not r.flags]
    assert len(pressed) > 16
    assert np.mean([r.location_mm for r in pressed]) == pytest.approx(35.0, abs=0.3)


def test_press_that_begins_right_after_a_forced_tare_ends_is_read_from_the_former_reference():
    """The third group after the release holds the begin of the press."""
    bench = Bench().run(8, (5.0, 20.0))
    bench.receiver.tare(force=True)
    bench.run(20, (5.0, 20.0)).run(2).run(1, turned_deg=-3.0).run(10, (2.0, 48.0)).run(5)
    pairs = bench.finished()
    assert not wrong(pairs)
    # How far the tag has turned is not known until the release.
    read = [r.force_n for press, r in pairs[-15:] if press and r.flags in ((), ("weak",))]
    assert len(read) == 9 and np.allclose(read, 2.0, atol=0.15)


@pytest.mark.parametrize("then", [[(7.0, 40.0), (5.0, 40.0)], [None]])
def test_tare_forced_over_a_press_that_changes_leaves_no_wrong_reading(then):
    """5 N, 7 N and 5 N again look like a press and a release from the wrong reference."""
    bench = Bench().run(8, (5.0, 40.0))
    bench.receiver.tare(force=True)
    bench.run(20 if then[0] else 6, (5.0, 40.0))
    for press in then:
        bench.run(20, press)
    assert not wrong(bench.finished())


def test_tare_forced_on_a_sensor_that_only_looks_touched_ends_with_a_press_and_its_release():
    """A moved cable may turn one end; nothing else than force ends that."""
    turned = np.array([70.0, 0.0])
    bench = Bench().run(20, turned_deg=turned)
    assert bench.receiver.tare().state == "refused"
    bench.receiver.tare(force=True)
    bench.run(20, turned_deg=turned)
    bench.run(10, (4.0, 60.0), turned_deg=turned).run(10, turned_deg=turned)
    pairs = bench.run(20, (3.0, 50.0), turned_deg=turned).run(5, turned_deg=turned).finished()
    assert not wrong(pairs)
    assert sum(not r.flags for _, r in pairs[-25:-5]) > 16


@pytest.mark.parametrize("location_mm", [20.0, 40.0, 60.0])
@pytest.mark.parametrize("free", [1, 2])
def test_press_that_begins_within_the_first_reference_leaves_no_wrong_reading(free, location_mm):
    """Its reference is a mean over both; the release shows the untouched line."""
    press = (5.0, location_mm)
    bench = Bench(reference=[None] * free + [press])
    pairs = bench.run(20, press).run(20).finished()
    assert not wrong(pairs)
    assert sum(not r.flags for _, r in pairs[-18:]) > 12


def test_tare_with_one_of_two_tags_off_keeps_its_reference():
    bench = Bench(sensors=2)
    bench.run(20, None, None, silent=[1])
    bench.receiver.tare()
    bench.run(20, None, None, silent=[1])
    assert bench.states[-1].state == "complete"
    assert "s1 not received" in bench.states[-1].reason
    bench.run(10, None, None).run(10, (4.0, 30.0), (3.0, 50.0)).run(5, None, None)
    for sensor in (0, 1):
        clear = [r for press, r in bench.finished(sensor)[-15:] if press and not r.flags]
        assert len(clear) > 6 and all(r.touch == 1 for r in clear)


@pytest.mark.parametrize("before", [None, (4.0, 30.0)])
@pytest.mark.parametrize("returns", [None, (4.0, 30.0)])
def test_tag_that_returns_is_read_from_the_old_reference(before, returns):
    bench = Bench().run(20, before).run(60, None, silent=[0])
    pairs = bench.run(20, returns).run(5).run(20, (4.0, 30.0)).run(3).finished()
    assert not wrong(pairs[96:]) and sum(not r.flags for _, r in pairs[-48:]) > 36


@pytest.mark.parametrize("turned_deg", [25.0, 170.0, -60.0])
def test_tag_that_returns_moved_is_doubted_at_first(turned_deg):
    bench = Bench().run(60, None, silent=[0])
    bench.run(40, turned_deg=turned_deg)
    pairs = bench.finished()
    assert not wrong(pairs) and all(r.flags for _, r in pairs[76:80])


@pytest.mark.parametrize("seed", cases(3, long=(0, 1, 2, 4, 5)))
def test_tare_at_any_moment_leaves_no_wrong_reading_without_a_flag(seed):
    rng = np.random.default_rng([seed, 7])
    bench, press = Bench(seed=seed), None
    for _ in range(60):
        if rng.random() < 0.4:
            press = None if press else (rng.uniform(2, 7), rng.uniform(10, 70))
        if rng.random() < 0.5:
            bench.receiver.tare(force=rng.random() < 0.3)
        if rng.random() < 0.1:
            bench.run(int(rng.integers(20, 50)), press, silent=[0])
        bench.run(int(rng.integers(1, 20)), press)
    pairs = [(press, r) for press, r in bench.finished() if r.touch is not None]
    assert not wrong(pairs)
    assert sum(not r.flags for _, r in pairs) > 30
