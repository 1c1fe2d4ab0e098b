# SPDX-License-Identifier: GPL-3.0-or-later
"""The device: one loop that moves one clock and does everything in its order."""

import select
import time
from collections import Counter as Tally
from collections import deque

from .air import Tuning
from .clock import DeviceClock
from .control import Control
from .eeprom import (
    DAUGHTERBOARD_RX,
    DAUGHTERBOARD_TX,
    MOTHERBOARD,
    I2cBus,
    daughterboard_image,
    motherboard_image,
)
from .faults import SENSOR_KINDS, FaultQueue
from .fifo import Fifo
from .frontend import DAUGHTERBOARDS, FrontEnd
from .pacing import HostBacklog, Throttle, WallClock
from .receive import ReceiveChain
from .registers import Registers
from .sockets import Sockets, check_loopback
from .transmit import TransmitChain
from .wire import (
    CONTROL_PORT,
    FIFO_PORT,
    GPS_PORT,
    RX_PORTS,
    SR_GPIO,
    SR_RX_CONTROL,
    SR_RX_DSP,
    SR_SPI,
    SR_TX_CONTROL,
    SR_TX_DSP,
    TX_PORT,
    Malformed,
    is_announcement,
)

_STEP_SAMPLES = 32_000
_STEP_TICKS = 1_000_000
_IDLE_WAIT_S = 0.01
_HOLD_WAIT_S = 0.0005


class Device:
    """A software N210.

    Parameters
    ----------
    air : Cable or one of its kind
        What is between the connectors.
    address : str
        Loopback address to listen on.
    board : str
        Daughterboard, of :data:`frontend.DAUGHTERBOARDS`.
    speed : float
        Device seconds per wall second, at most.
    lossless : bool
        Hold device time while the host is behind; False is real time.
    faults : iterable of Fault

    Attributes
    ----------
    counters : collections.Counter
        Packets taken and ignored (``malformed``, ``foreign``), by name.

    Raises
    ------
    InputError
        When the address cannot be used.
    """

    def __init__(self, air, address="127.0.0.1", board="SBX", speed=1.0, lossless=True, faults=()):
        self.address = check_loopback(address)
        self.air = air
        self.clock = air.clock = DeviceClock()
        self.counters = Tally()
        self.front_end = FrontEnd(DAUGHTERBOARDS[board])
        self._sockets = Sockets(address)
        window_bytes = self._sockets.receive_buffer(TX_PORT)
        self.transmit = TransmitChain(self.clock, air, window_bytes)
        self.receive = [ReceiveChain(self.clock, air, 3 + k) for k in range(len(RX_PORTS))]
        self.tuning = air.tuning = Tuning(self.front_end, self.transmit.dsp)
        self._faults = FaultQueue()
        for fault in faults:
            self.add_fault(fault)
        self._origin = None
        self._stop = False
        self._rx_peers = [None] * len(RX_PORTS)
        self._tx_peer = None
        registers = self._registers()
        self._fifo = Fifo(registers, self.clock)
        self._control = Control(registers, self._bus(board), self._end_session)
        self._wall = WallClock(speed)
        self._backlog = HostBacklog() if lossless else None
        self._throttle = Throttle(self._backlog) if lossless else None
        self._outbox = deque()
        self._port_of = {sock.fileno(): port for port, sock in self._sockets.items()}
        self._callbacks, self._unfinished = {}, set()

    def watch(self, descriptor, callback):
        """Call ``callback()`` from the loop whenever a file descriptor can be read.

        While it returns True it is called in the next turn again.
        """
        self._callbacks[descriptor] = callback

    def unwatch(self, descriptor):
        """Undo `watch`."""
        self._callbacks.pop(descriptor, None)

    def add_fault(self, fault):
        """One more fault to come.

        Raises
        ------
        InputError
            When it names a sensor that is not on the air.
        """
        if fault.kind in SENSOR_KINDS:
            self.air.check_sensor(fault.arguments[0])
        self._faults.add(fault)

    def stop(self):
        """Make `run` return; may be called from a signal handler."""
        self._stop = True

    def close(self):
        """Give back ports and files."""
        self._sockets.close()
        if self._backlog is not None:
            self._backlog.close()
            self._backlog = None

    def run(self):
        """Serve until `stop`."""
        wait_s = 0.0
        while not self._stop:
            ready, _, _ = select.select(
                [*self._port_of, *self._callbacks], [], [], 0 if self._unfinished else wait_s
            )
            self._serve(ready)
            wait_s = self._advance()

    def status(self):
        """Counters and state as a dict of plain values."""
        return {
            "device_time_s": self.clock.time / 1e8,
            "cpu_s": time.process_time(),
            "streaming_s": 0.0 if self._origin is None else (self.clock.ticks - self._origin) / 1e8,
            "rx_streaming": any(chain.active for chain in self.receive),
            "tx_streaming": self.transmit.in_burst,
            "tx_carrier_hz": self.tuning.tx_carrier_hz,
            "rx_carrier_hz": self.tuning.rx_carrier_hz(self.receive[0].dsp),
            "tx_gain_db": self.tuning.tx_gain_db,
            "rx_gain_db": self.tuning.rx_gain_db,
            "rx_dropped_samples": sum(chain.dropped_samples for chain in self.receive),
            "rx_dropped_packets": sum(chain.dropped_packets for chain in self.receive),
            "tx_underflows": self.transmit.underflows,
            "tx_late_packets": self.transmit.late_packets,
            "tx_sequence_errors": self.transmit.sequence_errors,
            **{name: self.counters[name] for name in ("malformed", "foreign", "faults")},
            **self.air.status(),
        }

    def _registers(self):
        registers = Registers(self.clock)
        registers.attach(SR_SPI, 3, self.front_end.poke_spi)
        registers.attach(SR_GPIO, 5, self.front_end.poke_gpio)
        registers.attach(SR_TX_CONTROL, 6, self.transmit.poke)
        registers.attach(SR_TX_DSP, 3, self.transmit.dsp.poke)
        for chain, control, dsp in zip(self.receive, SR_RX_CONTROL, SR_RX_DSP, strict=True):
            registers.attach(control, 9, chain.poke)
            registers.attach(dsp, 3, chain.dsp.poke)
        return registers

    def _bus(self, board):
        boards = DAUGHTERBOARDS[board]
        serial = "".join(f"{int(part):02x}" for part in self.address.split("."))
        return I2cBus(
            {
                MOTHERBOARD: motherboard_image(self.address, serial),
                DAUGHTERBOARD_RX: daughterboard_image(boards.rx_id),
                DAUGHTERBOARD_TX: daughterboard_image(boards.tx_id),
            }
        )

    def _end_session(self):
        """The host has closed the device: the next one finds it as after power-on."""
        for chain in self.receive:
            chain.stop()
            chain.stream_start = None
        self._origin = None
        self._outbox.clear()
        self.air.restart()

    def _serve(self, descriptors):
        """Take what has come in, in the order in which a host means it."""
        ready = {self._port_of.get(descriptor) for descriptor in descriptors}
        # Samples are read first and handed on last: a register write that was sent before
        # them, on another socket, must act before them.
        samples = self._sockets.drain(TX_PORT) if TX_PORT in ready else []
        if FIFO_PORT in ready:
            self._each(FIFO_PORT, self._submit)
        self._run_fifo()
        if CONTROL_PORT in ready:
            self._each(CONTROL_PORT, self._answer)
        for index, port in enumerate(RX_PORTS):
            if port in ready:
                self._each(port, lambda data, peer, k=index: self._announce_rx(k, data, peer))
        if GPS_PORT in ready:
            self._sockets.drain(GPS_PORT)
        if samples and self._throttle:
            self._throttle.tx_arrived()
        self._guarded(samples, self._accept)
        due = self._unfinished | (self._callbacks.keys() & set(descriptors))
        self._unfinished = {descriptor for descriptor in due if self._callbacks[descriptor]()}

    def _each(self, port, handle):
        self._guarded(self._sockets.drain(port), handle)

    def _guarded(self, datagrams, handle):
        """Handle datagrams one by one; what is malformed is counted and forgotten."""
        for datagram, peer in datagrams:
            try:
                handle(datagram, peer)
            except Malformed:
                self.counters["malformed"] += 1

    def _submit(self, datagram, peer):
        if not is_announcement(datagram):
            self._fifo.submit(datagram, peer)

    def _run_fifo(self):
        for reply, peer in self._fifo.run():
            self._sockets.send(FIFO_PORT, reply, peer)

    def _answer(self, datagram, peer):
        reply = self._control.reply(datagram)
        if reply is not None:
            self._sockets.send(CONTROL_PORT, reply, peer)

    def _announce_rx(self, index, datagram, peer):
        if not is_announcement(datagram):
            raise Malformed("only announcements are taken on a receive port")
        self._rx_peers[index] = peer

    def _accept(self, datagram, peer):
        if is_announcement(datagram):
            self._tx_peer = peer
        elif peer != self._tx_peer:
            self.counters["foreign"] += 1
        else:
            self.transmit.accept(datagram)

    def _advance(self):
        """Move device time on by at most one step; seconds to wait before the next."""
        for fault in self._faults.due(self.clock, self._origin):
            self._inject(fault)
        if not self._deliver():
            return _HOLD_WAIT_S
        start = self.clock.ticks
        end = start + min(self._wall.allowance(start), self._longest_step())
        end = self._until_event(end)
        if end > start and self._throttle and self._streaming:
            end = self._held(start, end)
            if end == start:
                return _HOLD_WAIT_S
        if end > start:
            self._step(start, end)
        return self._wait_after(end)

    def _deliver(self):
        """Send received samples on; False when the host has no room for the rest yet."""
        while self._outbox:
            index, data, size = self._outbox.popleft()
            peer = self._rx_peers[index]
            room = self._throttle.room(peer, size) if self._throttle else len(data)
            if room is None:  # nobody is left to read
                self.receive[index].stop()
                continue
            part, rest = data[: room * size], data[room * size :]
            self._sockets.send_segments(RX_PORTS[index], part, size, peer)
            if rest:
                self._outbox.appendleft((index, rest, size))
                return False
        return True

    @property
    def _streaming(self):
        return self.transmit.busy or any(chain.waiting for chain in self.receive)

    def _longest_step(self):
        spacings = [chain.dsp.ticks_per_sample for chain in self.receive if chain.waiting]
        if self.transmit.busy:
            spacings.append(self.transmit.dsp.ticks_per_sample)
        return min((_STEP_SAMPLES * spacing for spacing in spacings), default=_STEP_TICKS * 10)

    def _until_event(self, end):
        """Cut a step short where something must act, or a host may want to answer."""
        start = self.clock.ticks
        ticks = [self._fifo.next_tick(), self._faults.next_tick(self.clock, self._origin)]
        ticks = [max(tick, start) for tick in ticks if tick is not None]
        finished = [chain.finish_tick() for chain in self.receive]
        return min([end, *ticks, *(tick for tick in finished if tick is not None and tick > start)])

    def _held(self, start, end):
        """How far a step may go before transmit samples are missing, under lossless pacing."""
        covered = self.transmit.covered_until(end)
        return self._throttle.transmit_until(covered, start, end)

    def _step(self, start, end):
        """Everything that happens between two ticks: transmit, receive, then what is due."""
        self.transmit.run(start, end)
        for index, chain in enumerate(self.receive):
            if not chain.waiting:
                continue
            sent = chain.run(start, end)
            if self._origin is None:
                self._origin = chain.stream_start
            if self._rx_peers[index] is not None:
                self._outbox.extend((index, memoryview(data), size) for data, size in sent)
        self._deliver()
        self.clock.advance(end)
        self.air.forget(end)
        self._run_fifo()
        self._report()

    def _report(self):
        reports = self.transmit.reports()
        if self._tx_peer is not None:
            for report in reports:
                self._sockets.send(TX_PORT, report, self._tx_peer)

    def _wait_after(self, end):
        if not self._streaming:
            pending = self._until_event(end + _STEP_TICKS) - end
            return min(_IDLE_WAIT_S, max(self._wall.seconds_for(pending), 0.0))
        ahead = self._longest_step() - self._wall.allowance(end)
        return max(self._wall.seconds_for(ahead), 0.0)

    def _inject(self, fault):
        """Let a fault happen now; its kind is the name of the method that does it."""
        getattr(self, f"_fault_{fault.kind}")(*fault.arguments)
        self.counters["faults"] += 1

    def _fault_overflow(self, samples, stop=None):
        self.receive[0].overflow(samples, restart=stop is None)

    def _fault_lose(self, packets):
        self.receive[0].lose_packets(packets)

    def _fault_swap(self):
        self.receive[0].swap_packets()

    def _fault_late(self, which):
        (self.receive[0] if which == "rx" else self.transmit).make_late()

    def _fault_stall(self, seconds):
        time.sleep(seconds)

    def _fault_clock(self, sensor, ppm):
        self.air.set_clock_offset(sensor, ppm)

    def _fault_off(self, sensor):
        self.air.switch_tag(sensor, on=False)

    def _fault_on(self, sensor):
        self.air.switch_tag(sensor, on=True)
