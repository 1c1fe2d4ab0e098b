# SPDX-License-Identifier: GPL-3.0-or-later
"""A software USRP for any test: a process at a loopback address of its own."""

import json
import random
import subprocess
import sys

import pytest

_TRIES = 30
_STOP_S = 10


class SoftwareUsrp:
    """A running software N210.

    Attributes
    ----------
    address : str
    args : str
        UHD device arguments that name it.
    """

    def __init__(self, *arguments, speed=1.0, faults=(), address=None):
        command = [sys.executable, "-m", "software_n210", *map(str, arguments)]
        command += ["--speed", str(speed)]
        for fault in faults:
            command += ["--fault", fault]
        for _ in range(_TRIES):
            self.address = address or f"127.0.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
            self.process = subprocess.Popen(
                [*command, "--bind", self.address],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            if self.process.stdout.readline().startswith("listening"):
                break
            _, reason = self.process.communicate(timeout=_STOP_S)
            if "is in use" not in reason:
                raise RuntimeError(reason)
        self._ending = False  # on request; a signal might then find Python without its handlers
        # With the type UHD skips the search for other kinds of devices, which takes 0.5 s.
        self.args = f"addr={self.address},type=usrp2"

    def command(self, line):
        """The answer to a line of its control, as a dict."""
        try:
            self._ending = line == "stop"
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()
            return json.loads(self.process.stdout.readline())
        except (BrokenPipeError, json.JSONDecodeError):
            raise RuntimeError(f"the device has ended: {self.process.stderr.read()}") from None

    def stop(self):
        """End it; (exit status, standard error)."""
        if not self._ending and self.process.poll() is None:
            self.process.terminate()
        try:
            _, said = self.process.communicate(timeout=_STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode, said


@pytest.fixture
def software_usrp():
    """Starts devices: ``software_usrp(SCENE or "--air", "cable", ..., speed=1, faults=())``."""
    running = []

    def start(*arguments, **options):
        running.append(SoftwareUsrp(*arguments, **options))
        return running[-1]

    yield start
    for device in running:
        if device.process.returncode is None:
            device.stop()
