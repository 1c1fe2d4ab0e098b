# SPDX-License-Identifier: GPL-3.0-or-later
"""When a device is opened, given up and opened again, without devices and without waiting."""

import os
import subprocess
import sys
from itertools import pairwise
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.device_lock import DeviceBusy, DeviceLock
from machine import own_address
from wiforce_app.live.radio_keeper import RadioKeeper
from wiforce_app.radio.request import DeviceAbsent, DeviceLost
from wiforce_app.radio.streams import Progress

ABSENT = DeviceAbsent("--args", "must name a device that answers")
BUSY = DeviceBusy("--args", "must name a device that is free")
GAIN = InputError("--rx-gain", "must be 0 to 38 dB with this device", 99)
LOST = DeviceLost("does not answer any more")


class Bench:
    """A keeper whose devices do what is on a list, one entry for each time it opens one.

    An entry is the error of an attempt to open, or the seconds after which the device is lost.
    """

    def __init__(self, *fates, reconnect=True):
        self.now_s, self.opened_s = 0.0, []
        self.fates, self.link = list(fates), None
        self.session = SimpleNamespace(
            attach=lambda link: None, next_request=lambda request: request, silent_s=0.0
        )
        self.states = []  # behind opening
        self.keeper = RadioKeeper(
            SimpleNamespace(args="addr=1"),
            self.session,
            reconnect,
            link=self._link,
            now=lambda: self.now_s,
        )

    def _link(self, request):
        fate = self.fates.pop(0) if self.fates else ABSENT
        began_s = self.now_s
        self.opened_s.append(began_s)

        def poll():
            if isinstance(fate, Exception):
                raise fate
            if self.now_s - began_s > fate:
                raise LOST

        self.link = Mock(poll=poll, opened=True, started=True, underflow_s=0.0)
        return self.link

    def run(self, seconds):
        for _ in range(round(10 * seconds)):
            self.now_s = round(self.now_s + 0.1, 1)
            before = self.keeper.state
            self.keeper.look()
            if self.keeper.state != before:
                self.states.append(self.keeper.state)

    @property
    def pauses_s(self):
        return [round(after - before, 1) for before, after in pairwise(self.opened_s)]


def test_keeper_absent_device_is_sought_ever_less_often(capsys):
    bench = Bench()
    bench.run(200)
    assert bench.pauses_s == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0, 30.0, 30.0]
    assert bench.states == [] and bench.keeper.waits
    assert capsys.readouterr().err.count("\n") == 1  # not a line for each attempt
    bench.run(1000)
    assert capsys.readouterr().err.count("\n") == 1  # but one every ten minutes


def test_keeper_loss_reopens_and_reports_states():
    bench = Bench(5.0, ABSENT, ABSENT, 60.0)
    bench.run(20)
    assert bench.states == ["running", "reconnecting", "running"]
    assert not bench.keeper.waits
    # At 5.1 s, and then after 0.5, 1 and 2 s.
    assert bench.opened_s == pytest.approx([0.1, 5.8, 6.8, 8.8], abs=0.11)


def test_keeper_device_lost_again_at_once_is_not_hammered():
    bench = Bench(*[0.5] * 40)
    bench.run(300)
    assert bench.pauses_s[-1] > 30
    steady = Bench(*[15.0] * 10)
    steady.run(100)
    assert max(steady.pauses_s) < 16.5  # a device that has run for a while is reopened soon


@pytest.mark.parametrize(
    ("fate", "reconnect", "error"),
    [
        (BUSY, True, DeviceBusy),
        (GAIN, True, InputError),
        (ABSENT, False, DeviceAbsent),
        (3.0, False, DeviceLost),
    ],
)
def test_keeper_ends_with_what_no_waiting_mends(fate, reconnect, error):
    with pytest.raises(error):
        Bench(fate, reconnect=reconnect).run(10)


@pytest.mark.parametrize("error", [BUSY, GAIN])
def test_keeper_found_once_goes_on_whatever_comes_back(error):
    """A device that starts up may refuse a setting, and another run may hold it for a moment."""
    bench = Bench(12.0, error, error, 60.0)
    bench.run(30)
    assert bench.keeper.state == "running" and len(bench.opened_s) == 4


def test_keeper_silent_driver_is_given_up():
    """A driver that hangs reports nothing by itself."""
    bench = Bench(600.0, 600.0)
    bench.run(5)
    for _ in range(200):
        bench.session.silent_s += 0.1
        bench.run(0.1)
        if bench.states[-1] == "reconnecting":
            break
    assert 8.0 < bench.session.silent_s < 8.3


def test_lock_second_process_is_refused_until_the_first_ends():
    program = (
        "import sys\n"
        "from gnuradio.wiforce.io.network.device_lock import DeviceLock\n"
        "lock = DeviceLock(sys.argv[1])\n"
        "lock.take_serial(sys.argv[2])\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()\n"
    )
    own, args = os.getpid(), f"addr={own_address()}"
    command = [sys.executable, "-c", program, f"type=x,{args},tag=y", f"serial{own}"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(DeviceBusy, match="in use by another process"):
            DeviceLock(args, handover_s=0.2)
        with pytest.raises(DeviceBusy, match="in use by another process"):
            # Opened by another address, it is known by its serial number.
            DeviceLock("addr=127.1.2.4").take_serial(f"serial{own}")
        other.kill()
        other.wait()
    lock = DeviceLock(args, handover_s=0.2)
    lock.take_serial(f"serial{own}")
    lock.release()
    DeviceLock(args, handover_s=0.2).release()


def test_keeper_warns_of_underflows_at_growing_intervals(capsys):
    """Readings were missing, and nothing said that the machine did not keep up."""
    bench = Bench(100.0)
    bench.keeper.look()
    for second in range(6):
        bench.now_s, bench.link.underflow_s = float(second), 0.5 * (second + 1)
        bench.keeper.look()
    said = capsys.readouterr().err
    assert 1 < said.count("transmit underflow: no frames were sent for 0.50 s") < 6


def test_a_process_that_was_stopped_does_not_take_its_device_for_lost():
    """After `kill -STOP`, or on a busy machine, a reader ended although all was well."""
    now = [0.0]
    progress = Progress(lambda: now[0])
    progress.still_s(7)
    found = []
    for passed_s in (0.02, 0.02, 6.0, 0.02):
        now[0] += passed_s
        found.append(progress.still_s(7))
    assert found == pytest.approx([0.02, 0.04, 0.24, 0.26])
    assert progress.still_s(8) == 0


def test_keeper_asked_again_to_stop_does_not_leave_the_device_to_a_driver_that_hangs():
    """The next run could not open the device, which that process had kept."""
    link = Mock(opened=True, started=True, underflow_s=0.0)
    link.stop.side_effect = KeyboardInterrupt
    bench = Bench()
    bench.keeper._make_link = lambda request: link
    bench.run(1)
    with pytest.raises(KeyboardInterrupt):
        bench.keeper.stop()
    link.discard.assert_called_once_with()
