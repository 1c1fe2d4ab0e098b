# SPDX-License-Identifier: GPL-3.0-or-later
"""The dialogue of ``gr-wiforce calibrate --live``: asks, measures, says what was wrong."""

import time

from gnuradio.wiforce.calibration.gauges import parse_force
from gnuradio.wiforce.calibration.session import (
    measure_press,
    measure_untouched,
    steady_deg,
)
from gnuradio.wiforce.errors import InputError

HELP = """\
  Type the force that the gauge shows while you hold the press still: 2.5, or with a unit, 250 g.
  With --scale, press Enter instead. Single letters are commands:
    u  undo: remove the last measurement that was stored
    s  skip this force           n  skip the rest of this location
    r  show how much is measured, and what does not fit
    f  finish now with what is stored
    q  quit; everything stored is kept. The same command continues, with a new reference of the
       untouched sensor"""


# What the person sees, instead of the library's parameters.
_WORDS = {"force_n": "force", "measurement": "untouched sensor"}


class GuidedCalibration:
    """Leads a person, who types ``lines``, through a session; forces may come from a scale."""

    def __init__(self, session, presses, lines, echo, scale=None):
        self._session, self._presses, self._lines = session, presses, lines
        self._echo, self._scale = echo, scale
        plan = session.plan
        self._largest_deg = steady_deg(plan.frequency_hz, plan.permittivity)
        self._location_mm, self._ended = None, None
        self._commands = {
            "u": self._undo,
            "s": session.skip,
            "n": lambda target: session.skip_location(target.location_mm),
            "r": lambda target: self.show_progress(),
            "f": lambda target: self._end(True),
            "q": lambda target: self._end(False),
            "?": lambda target: self._echo(HELP),
        }

    def run(self):
        """Measure until all is measured, or ended; whether a sensor is to be made of it."""
        self._introduce()
        self._presses.wait_for_reference(self._idle)
        while self._ended is None:
            target = self._session.next_target()
            if target is None:
                self.show_progress()
                return True
            if target.location_mm != self._location_mm:
                self._begin_location(target)
            else:
                self._ask(target)
        return self._ended

    def _introduce(self):
        session, plan = self._session, self._session.plan
        self._echo(
            f"Sensor {plan.sensor} at {plan.frequency_hz / 1e6:g} MHz: "
            f"{', '.join(f'{place:g}' for place in plan.location_mm)} mm from port 1, at each "
            f"{len(plan.force_n)} forces of {plan.force_n[0]:g} to {plan.force_n[-1]:g} N."
        )
        taken = len(session.presses)
        if taken:
            self._echo(f"Presses stored in {session.path}: {taken}; the session continues.")
        else:
            self._echo(f"Every measurement is stored in {session.path} at once.")
        self._echo("Type ? for help. Leave the sensor untouched: the reference is measured ...")

    def _begin_location(self, target):
        if self._location_mm is not None:
            self.show_progress()
            self._location_mm = None
        prompt = (
            f"\nRelease the sensor, set the ruler to {target.location_mm:g} mm from port 1, "
            "and press Enter while it is untouched: "
        )
        if self._answer(prompt, target) is None:
            return
        collect = self._presses.collect
        untouched = self._store(lambda: measure_untouched(collect(self._idle), self._largest_deg))
        if untouched is not None:
            self._echo(f"  untouched: {_phases(untouched)}; stored")
            self._location_mm = target.location_mm

    def _ask(self, target):
        how = "type the force" if self._scale is None else "press Enter"
        at = f"{target.location_mm:g} mm, about {target.force_n:g} N"
        line = self._answer(f"{at}: press, hold still, {how}: ", target)
        press = None if line is None else self._store(lambda: self._press(line, target))
        if press is not None:
            done, wanted = self._session.done()
            self._echo(f"  {press.force_n:.2f} N: {_phases(press)}; stored, {done} of {wanted}")

    def _answer(self, prompt, target):
        """The line that is typed; None where it was a command, or at the end of input."""
        self._echo(prompt, nl=False)
        line = self._lines.next(self._idle)
        command = self._commands.get("q" if line is None else line.lower())
        if command is None:
            return line
        if line is None:
            self._echo("")
        command(target)
        return None

    def _store(self, measure):
        """The measurement that was made and stored; None where it was refused."""
        try:
            measurement = measure()
            self._session.add(measurement)
        except InputError as error:
            self._echo(f"  not stored: {error.renamed(_WORDS)}")
            return None
        return measurement

    def _press(self, line, target):
        std_n = float("nan")
        if self._scale is None:
            if not line:
                raise InputError("force", "must be typed, or ? for help")
            force_n = parse_force(line)
            self._session.check_force(force_n, target.force_n)
            readings = self._presses.collect(self._idle)
        else:
            if line:
                raise InputError("line", "must be empty: the scale measures (? for help)")
            force_n, std_n, readings = self._collect_with_scale()
            self._session.check_force(force_n, target.force_n)
        return measure_press(
            readings, target.location_mm, force_n, self._largest_deg, std_n, target.sweep
        )

    def _collect_with_scale(self):
        gauge = self._scale.gauge
        gauge.check_alive(time.monotonic())
        begin_s = time.monotonic()
        readings = self._presses.collect(self._idle)
        while not gauge.heard_since(begin_s):
            gauge.check_alive(time.monotonic())
            self._idle()
            time.sleep(0.02)
        return *gauge.mean(begin_s, time.monotonic()), readings

    def _undo(self, target):
        removed = self._session.undo()
        if removed is None:
            self._echo("  nothing is stored")
        elif removed.untouched:
            self._location_mm = None
            self._echo("  removed: the untouched sensor")
        else:
            self._echo(f"  removed: {removed.force_n:.2f} N at {removed.location_mm:g} mm")

    def _end(self, finished):
        self._ended = finished

    def show_progress(self):
        """Show how many measurements are taken, and which do not fit the others."""
        self._echo("\n{} of {} measurements".format(*self._session.done()))
        try:
            doubts = self._session.doubts()
        except InputError as error:
            doubts = [f"these measurements do not make a sensor: {error}"]
        for doubt in doubts:
            self._echo(f"  doubtful: {doubt}")

    def _idle(self):
        self._presses.idle()
        if self._scale is not None:
            self._scale.poll()


def _phases(measurement):
    first, second = measurement.phase_deg
    std = max(measurement.phase_std_deg)
    return f"phases {first:.2f} / {second:.2f} deg, std {std:.2f} deg, {measurement.groups} groups"
