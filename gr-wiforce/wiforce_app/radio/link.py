# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader's end of a process that uses a device (:mod:`.process`)."""

import contextlib
import multiprocessing
import signal
import socket
import subprocess

from gnuradio.wiforce.errors import InputError

from ..shell.processes import spawned
from .request import LOST_STATUS, DeviceLost, RadioRequest

_CLOSE_S = 5.0  # UHD takes 1.5 s to close a device


class RadioLink:
    """A device, opened in a process of its own."""

    def __init__(self, request: RadioRequest):
        self.hardware: str | None = None  # kind and serial number, once the device is open
        self.settings: dict = {}  # gains and antennas
        self.aligned = False  # whether the samples begin with a frame
        self.unlocked: list[str] = []  # directions (tx, rx) whose oscillator has not locked
        self.started = False  # samples have been received
        # Offset of UTC from the device's clock by the latest comparison, and its uncertainty, in s.
        self.clock: tuple[float, float] | None = None
        self.underflows_s: list[float] = []  # how long nothing was transmitted; to be taken
        self._stopped = False
        self._samples: socket.socket | None
        self._samples, samples = socket.socketpair()
        self._control, control = multiprocessing.Pipe()
        with samples, control:
            self._process = spawned(f"{__package__}.process", control.fileno(), samples.fileno())
        self._send(request)

    @property
    def opened(self) -> bool:
        """Whether the device is open."""
        return self.hardware is not None

    def take_samples(self) -> socket.socket:
        """Where the samples arrive; given once, to a ``sample_receiver``, which closes it."""
        assert self._samples is not None
        samples, self._samples = self._samples, None
        return samples

    def start(self) -> None:
        """Start both streams, once the device is open."""
        self._send("start")

    def poll(self, timeout_s: float = 0.0) -> None:
        """Take what the process reports, or raise DeviceAbsent, -Busy, -Unusable or -Lost."""
        while self._control.poll(timeout_s):
            try:
                report = self._control.recv()
            except (EOFError, OSError):
                raise DeviceLost(self._end()) from None
            self._take(*report)
            timeout_s = 0.0

    def stop(self, timeout_s: float = 2.0) -> None:
        """Stop both streams; the samples received so far arrive before the stream ends."""
        self._send("stop")
        with contextlib.suppress(DeviceLost, InputError):
            while not self._stopped:
                if not self._control.poll(timeout_s):
                    break
                self.poll()

    def close(self, timeout_s: float = _CLOSE_S) -> None:
        """Close the device and end the process."""
        self._control.close()
        if self._samples is not None:
            self._samples.close()
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def discard(self) -> None:
        """End the process without waiting for its device, which is lost."""
        self._process.kill()
        self.close()

    def _take(self, event, value):
        if event == "opened":
            self.hardware, self.settings, self.unlocked, self.aligned = value
        elif event == "started":
            self.started = True
        elif event == "clock":
            self.clock = value
        elif event == "underflow":
            self.underflows_s.append(value)
        elif event == "stopped":
            self._stopped = True
        elif event == "failed":
            raise value

    def _send(self, message):
        with contextlib.suppress(OSError):  # it has ended, which `poll` reports
            self._control.send(message)

    def _end(self):
        """How the process has ended, in words."""
        try:
            status = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return "is lost: its process does not respond"
        if status == LOST_STATUS:
            return "cannot be reached any more"
        if status < 0:
            return f"is lost: its process was ended by {signal.Signals(-status).name}"
        return f"is lost: its process ended with status {status}"
