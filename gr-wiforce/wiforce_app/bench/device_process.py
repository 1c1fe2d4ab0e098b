# SPDX-License-Identifier: GPL-3.0-or-later
"""A software N210 in a process of its own, at a loopback address that is free."""

import json
import random
import subprocess
import sys
import threading

_TRIES = 30
_STOP_S = 10
# The command, whatever the name under which it is installed.
RUN = "from wiforce_app.main import run; raise SystemExit(run())"
EMULATE = (sys.executable, "-c", RUN, "emulate")


class DeviceProcess:
    """A running software N210, with the arguments of ``gr-wiforce emulate``.

    ``address`` is a loopback address, a free one when not given; ``args`` are the UHD device
    arguments that name it. A RuntimeError says why it does not start.
    """

    def __init__(self, *arguments, address=None, command=EMULATE):
        command = [*command, *map(str, arguments)]
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        for _ in range(_TRIES):
            self.address = address or f"127.0.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
            self.process = subprocess.Popen([*command, "--bind", self.address], text=True, **pipes)
            if self.process.stdout.readline().startswith("listening"):
                break
            _, reason = self.process.communicate(timeout=_STOP_S)
            if "is in use" not in reason:
                raise RuntimeError(reason.strip())
        self._ending = False  # on request; a signal might then find Python without its handlers
        self._lock = threading.Lock()
        # With the type UHD skips the search for other kinds of devices, which takes 0.5 s.
        self.args = f"addr={self.address},type=usrp2"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.returncode is None:
            self.stop()

    def command(self, line):
        """The answer to a line of its control, as a dict; may be called by several threads."""
        try:
            with self._lock:
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
