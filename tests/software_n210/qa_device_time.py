# SPDX-License-Identifier: GPL-3.0-or-later
"""What the software N210 does when: samples on the air, pacing and faults."""

import socket
from collections import deque

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from software_n210.air.cable import Cable, SampleHistory
from software_n210.faults import FaultQueue, parse_fault
from software_n210.hardware import DeviceClock
from software_n210.pacing import HostBacklog, Throttle, WallClock


def test_history_take_returns_nearest_samples_at_any_rate():
    history = SampleHistory()
    history.append(1000, 8, np.arange(1, 11).astype(np.complex64))
    history.append(2000, 8, np.full(3, 50, np.complex64))
    assert np.array_equal(history.take(984, 8, 5).real, [0, 0, 1, 2, 3])
    assert np.array_equal(history.take(1003, 8, 3).real, [1, 2, 3])  # the nearest
    assert np.array_equal(history.take(1000, 16, 6).real, [1, 3, 5, 7, 9, 0])
    assert np.array_equal(history.take(1000, 4, 4).real, [1, 2, 2, 3])
    assert np.array_equal(history.take(1992, 8, 5).real, [0, 50, 50, 50, 0])
    history.forget(1500)
    assert not history.take(1000, 8, 10).any() and history.take(2000, 8, 3).all()


def test_cable_old_samples_forgotten():
    cable = Cable(delay_ticks=512)
    for tick in range(0, 800_000, 8000):
        cable._sent.append(tick, 8, np.ones(1000, np.complex64))
        cable.forget(tick)
    assert len(cable._sent._segments) <= 3


def test_wall_clock_after_a_pause_does_not_catch_up():
    now = [100.0]
    clock = WallClock(speed=0.5, now=lambda: now[0])
    assert clock.allowance(0) == 0
    now[0] += 0.01
    assert clock.allowance(0) == 500_000
    assert clock.allowance(500_000) == 0
    now[0] += 10  # a pause of the whole machine
    assert clock.allowance(500_000) == 1_000_000  # 20 ms of wall time
    assert clock.held_s == pytest.approx(9.98)  # what the last line of `emulate` says
    now[0] += 0.001
    assert clock.allowance(1_500_000) == 50_000


class Backlog:
    def __init__(self, values):
        self.values = deque(values)

    def read(self, peer):
        return self.values[0] if len(self.values) == 1 else self.values.popleft()


def test_throttle_slow_host_waited_for_and_deaf_one_not():
    now = [0.0]
    throttle = Throttle(Backlog([0, 170_000, 200_000]), now=lambda: now[0])
    assert throttle.room("host", 1472) == 180_000 // 2304
    assert throttle.room("host", 1472) == 4
    assert throttle.room("host", 1472) == 0
    now[0] += 0.29
    assert throttle.room("host", 1472) == 0
    now[0] += 0.02
    assert throttle.room("host", 1472) > 0
    assert Throttle(Backlog([None])).room("host", 1472) is None


def test_throttle_missing_transmit_samples_hold_time_for_a_while():
    now = [0.0]
    throttle = Throttle(None, now=lambda: now[0])
    throttle.tx_arrived()
    assert throttle.transmit_until(covered=900, start=0, end=900) == 900
    assert throttle.transmit_until(covered=300, start=0, end=900) == 0  # more will come
    now[0] += 0.01
    assert throttle.transmit_until(covered=300, start=0, end=900) == 300
    now[0] += 0.3
    assert throttle.transmit_until(covered=300, start=0, end=900) == 900  # an underflow then
    assert throttle.transmit_until(covered=900, start=0, end=900) == 900
    now[0] += 10  # what lacks only now is waited for, whenever the last samples came
    assert throttle.transmit_until(covered=300, start=0, end=900) == 0


def test_host_backlog_reads_bytes_queued_in_a_socket():
    backlog = HostBacklog()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        peer = sock.getsockname()
        assert backlog.read(peer) == 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(bytes(1472), peer)
        assert 1472 <= backlog.read(peer) <= 4096
        sock.recv(2000)
        assert backlog.read(peer) == 0
    assert backlog.read(peer) is None
    backlog.close()


def test_fault_queue_due_faults_come_in_order():
    clock, origin = DeviceClock(), None
    clock.poke(1, 50)
    clock.poke(3, 1)
    clock.poke(0, 0)  # device time is 50 ticks ahead
    faults = [parse_fault(t) for t in ("+0.000001 swap", "0.000002 lose 3", "0.000001 late rx")]
    queue = FaultQueue()
    for fault in faults:
        queue.add(fault)
    assert queue.next_tick(clock, origin) == 50
    clock.advance(150)
    assert [fault.kind for fault in queue.due(clock, origin)] == ["late", "lose"]
    assert queue.next_tick(clock, origin) is None
    # The host of a former stream, which began at 5, has not closed the device yet.
    assert queue.next_tick(clock, 5) is None and queue.due(clock, 5) == []
    queue.begin()
    assert queue.next_tick(clock, 1000) == 1100
    clock.advance(1100)
    assert [fault.kind for fault in queue.due(clock, 1000)] == ["swap"]


@pytest.mark.parametrize(
    "text",
    ["", "1", "x swap", "-1 swap", "1 swap 3", "nan lose 1", "1 clock arm fast", "1 clock arm nan"],
)
def test_parse_fault_invalid_text_refused(text):
    with pytest.raises(InputError, match="--fault"):
        parse_fault(text)
