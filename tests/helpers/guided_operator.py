# SPDX-License-Identifier: GPL-3.0-or-later
"""A scripted person who follows ``gr-wiforce calibrate --live`` at a software N210."""

import re
import subprocess
import sys
import threading
import time

import numpy as np

_PROMPTS = ("while it is untouched: ", "type the force: ", "still, press Enter: ")
_ASKED = re.compile(r"([\d.]+) mm, about ([\d.]+) N: press, hold still")
# A digital force gauge: 0.5 % of the reading, 0.02 N of zero, two decimals; a hand that holds
# within 5 % of what was asked for, and a ruler that is read within a quarter of a millimetre.
_GAIN_STD, _ZERO_STD_N, _NOISE_STD_N = 0.005, 0.02, 0.01
_HAND_PART, _RULER_STD_MM = 0.05, 0.25
# Least time from a press to its typed force: what the device has sent by then is read first.
_TYPING_S = 0.05


class GuidedOperator:
    """Answers the prompts of a guided calibration.

    ``device``: its sensor is pressed; the typed forces are those that its scene states, with the
    errors of a gauge; ``command``: arguments of ``gr-wiforce``; ``limit_s``: the command is ended
    after this time. ``shown``: what the command has shown so far, and what was typed.
    """

    def __init__(self, device, command, seed=1, limit_s=300):
        self._device, self._rng = device, np.random.default_rng(seed)
        self._gain = 1 + _GAIN_STD * self._rng.standard_normal()
        self._zero_n = _ZERO_STD_N * self._rng.standard_normal()
        self._place = None, None
        self.shown = ""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "wiforce_app.main", *map(str, command)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
        )
        self._timer = threading.Timer(limit_s, self.process.kill)
        self._timer.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._timer.cancel()
        self.process.kill()
        self.process.wait()
        print(self.shown)  # when a test fails

    def prompt(self):
        """The next prompt, or None when the command has ended."""
        text = ""
        while not text.endswith(_PROMPTS):
            data = self.process.stdout.read(1)
            if not data:
                self.shown += text
                return None
            text += data.decode()
        self.shown += text
        return text.rsplit("\n", 1)[-1]

    def type(self, line):
        self.shown += f"{line}\n"
        self.process.stdin.write(f"{line}\n".encode())

    def press(self, force_n, location_mm):
        """Press at this mark of the ruler, and return what the gauge shows, in N."""
        if self._place[0] != location_mm:
            self._place = location_mm, location_mm + _RULER_STD_MM * self._rng.standard_normal()
        self._device.command(f"press arm {force_n:.4f} {self._place[1]:.3f}")
        time.sleep(_TYPING_S)
        true_n = self._device.command("status")["sensors"]["arm"]["force_n"]
        noise_n = _NOISE_STD_N * self._rng.standard_normal()
        return round(true_n * self._gain + self._zero_n + noise_n, 2)

    def release(self):
        self._device.command("release arm")
        time.sleep(_TYPING_S)

    def answer(self, prompt):
        """Do what a prompt asks for."""
        asked = _ASKED.search(prompt)
        if asked is None:
            self.release()
            self.type("")
        else:
            location_mm, force_n = map(float, asked.groups())
            force_n *= 1 + _HAND_PART * self._rng.uniform(-1, 1)
            self.type(f"{self.press(force_n, location_mm):.2f}")

    def follow(self):
        """Answer prompts until the command ends."""
        while (prompt := self.prompt()) is not None:
            self.answer(prompt)
