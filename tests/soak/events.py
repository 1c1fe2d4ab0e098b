# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens to a live reader, and what it must say about it."""

import os
import resource

from gnuradio.wiforce.press.sensor_state import RETUNED
from loops import PRESS_S, RATE_HZ, RELEASE_S, SLOT_S
from world import OFF, STILL, RunEnded

_LONG_BREAK_S = 4000.0
_MOST_JUMP_S = 5000.0


class Events:
    """The events, each of which ends at the end of a slot.

    ``breaks_s``: shortest and longest time for which the device is lost. ``losses``: times that the
    device was lost and found.
    """

    def __init__(self, world, output, rng, breaks_s):
        self._world, self._output, self._rng = world, output, rng
        self._breaks_s, self.losses = breaks_s, 0

    def ordinary(self):
        """A press, or none."""
        self._world.play_slot(self._any_loop())

    def _any_loop(self):
        pressed = len(self._world.loops.loops) - 1
        return int(self._rng.integers(1, pressed + 1)) if self._rng.random() < 0.6 else STILL

    def _pressed(self):
        return int(self._rng.integers(1, len(self._world.loops.loops)))

    def _reference_problem(self):
        return RETUNED if self._world.retuned else ""

    def _expect_reading(self):
        self._world.expect("reading", reference_problem=self._reference_problem())

    # The device and its network

    def device_lost(self):
        """The device is lost in mid-packet, mid-press for example, and found with other phases."""
        world, rng = self._world, self._rng
        loop = self._any_loop()
        world.play(rng.uniform(0.1, 2.4), loop)
        silent = rng.random() < 0.2
        world.allow("reading", "lost")
        device = world.device
        device.absent = True
        if silent:
            world.leave()
            world.wait(9.0)  # the keeper gives it up
        else:
            world.send_part(int(rng.integers(1, 10_000)), loop)
            device.lose("cannot be reached any more")
            world.leave()
        world.wait(1.0)
        world.expect("lost", "the device is lost")
        if rng.random() < 0.3:
            self._tare_without_samples()
        self.losses += 1
        world.wait(_LONG_BREAK_S if self.losses == 5 else rng.uniform(*self._breaks_s))
        device.start_again()
        device.absent = False
        world.go_on_anywhere(rng)
        world.begin_stream()
        world.play_slot()
        world.expect("reading", reference_problem=RETUNED)

    def network_cut(self):
        """The network is gone for a while, shorter than a loss of the device."""
        world, rng = self._world, self._rng
        loop = self._any_loop()
        world.play(rng.uniform(0.1, 2.0), loop)
        world.settle()
        lost = round(rng.uniform(0.05, 4.5) * RATE_HZ)
        cut_s = lost / RATE_HZ
        world.allow("reading", "lost")
        world.wait(cut_s)
        if cut_s > 1.3:
            world.expect("lost", "no samples for")
        world.allow("reading", "lost", "acquiring")
        world.miss(lost)
        world.play_slot(loop)
        world.play_slot()
        world.play_slot()
        self._expect_reading()

    def overflow(self):
        """Some packets are lost; the time of the device says so."""
        world = self._world
        world.play(self._rng.uniform(0.1, 2.0), loop := self._any_loop())
        world.lose(int(self._rng.integers(1, 60_000)))
        world.play_slot(loop)

    def slip(self):
        """Samples are lost without a trace: the frame timing slips."""
        world = self._world
        world.play(self._rng.uniform(0.1, 1.5), loop := self._any_loop())
        world.lose(int(self._rng.integers(20, 300)), slips=True)
        world.play_slot(loop)
        world.play_slot()

    def wrong_time(self):
        """The device says a time that cannot be."""
        world = self._world
        world.play(self._rng.uniform(0.1, 2.0), loop := self._any_loop())
        # Two that agree would be a clock that was set.
        ahead_s = self._rng.uniform(-10, -2), self._rng.uniform(3700, 9000)
        world.device.tag_wrongly(ahead_s[self._rng.integers(2)])
        world.play_slot(loop)

    # The tag

    def tag_off(self):
        """The tag is off, and returns with its clock at another phase."""
        world, rng = self._world, self._rng
        loop = self._any_loop()
        world.play(rng.uniform(0.1, 2.4), loop)
        off_s = rng.uniform(0.05, min(12.0, 3 * self._breaks_s[1]))
        world.allow("reading", "lost", "acquiring")  # its clock must be found again
        world.play(off_s, OFF)
        if off_s > 2.0:
            world.expect("lost", "not received: arm")
            world.allow("lost", "reading", "acquiring")
        world.go_on_anywhere(rng)
        # It may be touched when it returns.
        world.play_slot(self._any_loop())
        world.play_slot()
        self._expect_reading()

    # Tares

    def tare(self):
        """A tare while nothing touches the sensor."""
        self._world.play(0.2)
        self._finish_tare(self._world.tare(), 0.8)
        self._world.retuned = False
        self._world.play_slot()
        self._expect_reading()

    def _finish_tare(self, request, seconds, outcome="complete", reason=""):
        world = self._world
        world.play(seconds)
        world.expect("reading", tare=outcome)
        self._answered(request, outcome, reason)

    def _answered(self, request, outcome, reason=""):
        answer = request.answer()
        said = answer.get("reason", "")
        if answer.get("state") != outcome or reason not in said:
            wanted = f"{outcome} ({reason})"
            self._world.report(f"a tare is answered {answer} instead of {wanted}")
        if answer.get("ok") != (outcome == "complete"):
            self._world.report(f"a tare that was {outcome} is answered {answer}")

    def tare_touched(self):
        """A tare during a press is refused."""
        world = self._world
        if world.retuned:
            return self.tare()
        # A touch is known when the next group has been read.
        seen_s = PRESS_S + max(0.25, 3 * world.group / RATE_HZ)
        world.play(self._rng.uniform(seen_s, RELEASE_S - 0.2), loop := self._pressed())
        self._answered(world.tare(), "refused", "arm is touched")
        world.play_slot(loop)
        return self._expect_reading()

    def tare_before_press(self):
        """A press begins while a tare is measured, which fails."""
        world = self._world
        if world.retuned:
            return self.tare()
        world.play(self._rng.uniform(PRESS_S - 0.2, PRESS_S - 0.1), loop := self._pressed())
        request = world.tare()
        world.play_slot(loop)
        world.expect("reading", tare="failed", reference_problem="")
        return self._answered(request, "failed", "the former reference is kept")

    def tare_forced(self):
        """A tare is forced during a press."""
        world = self._world
        if world.retuned:
            return self.tare()
        world.play(PRESS_S + 0.3, loop := self._pressed())
        request = world.tare(force=True)
        world.play(0.8, loop)
        world.expect("reading", tare="complete", reference_problem=True)
        self._answered(request, "complete")
        world.play_slot(loop)
        # Nobody knows what the release left; a tare makes the reference valid.
        world.play_slot()
        world.play(0.2)
        self._finish_tare(world.tare(force=True), 0.8)
        world.play_slot()
        for _ in range(3):
            world.play_slot()
        return None

    def _tare_without_samples(self):
        """A tare is requested while the device is lost: it gets an answer all the same."""
        request = self._world.tare()
        self._world.wait(0.5)
        answer = request.answer()
        if answer.get("state") not in ("refused", "failed"):
            self._world.report(f"a tare without samples is answered {answer}")

    def tare_in_loss(self):
        """The device is lost while a tare is measured."""
        world = self._world
        world.play(0.2)
        request = world.tare()
        world.play(0.2)
        world.leave()
        world.allow("reading", "reference", "lost")
        world.device.absent = True
        world.device.lose("cannot be reached any more")
        world.wait(3.0)
        world.expect("lost", tare="failed")
        self._answered(request, "failed", "no groups are received")
        world.device.start_again()
        world.device.absent = False
        world.go_on_anywhere(self._rng)
        world.begin_stream()
        world.play_slot()
        world.expect("reading", reference_problem=RETUNED)
        self.losses += 1

    def tare_without_tag(self):
        """The tag is off while a tare is measured."""
        world = self._world
        world.allow("reading", "lost", "acquiring")
        world.play(0.4, OFF)
        request = world.tare()
        world.allow("reading", "reference", "lost", "acquiring")
        world.play(3.0, OFF)
        world.expect("lost", tare="failed")
        self._answered(request, "failed", "the former reference is kept")
        world.allow("reading", "lost", "acquiring")
        world.go_on_anywhere(self._rng)
        world.play_slot()
        world.play_slot()
        self._expect_reading()

    # The host

    def clock_set(self):
        """Somebody sets the host's clock."""
        world = self._world
        world.clock.utc_offset_s += self._rng.uniform(-_MOST_JUMP_S, _MOST_JUMP_S)
        world.note_utc()
        world.play_slot(self._any_loop())

    def disk_full(self):
        """The disk is full: the run ends with status 1, and its file with a whole row."""
        world = self._world
        world.settle()
        size = self._output.stat().st_size
        most = size + int(self._rng.integers(1, 3000))
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        world.run.full = True
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
        world.allow("reading", "ended")
        try:
            for _ in range(100):
                world.play_slot(self._any_loop())
            world.report("a full disk does not end the run")
        except RunEnded:
            pass
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        if world.run.status != 1:
            world.report(f"a full disk gives exit status {world.run.status}")
        if os.path.getsize(self._output) > most:
            world.report("the limit of the file was not kept")

    def stopped(self):
        """Somebody stops the run, which is started again."""
        world = self._world
        world.play(self._rng.uniform(0.1, 2.0), self._any_loop())
        world.settle()
        world.allow("reading", "ended")
        answer = world.ask("stop").answer()
        if not answer.get("ok") or not world.ended.wait(60) or world.run.status != 0:
            world.report(f"stop is answered {answer}, exit status {world.run.status}")

    def started(self):
        """A run begins: it waits, measures its reference, refuses a tare meanwhile, and reads."""
        world = self._world
        world.device.absent = self._rng.random() < 0.5
        if world.device.absent:
            world.wait(2.0)
            report = world.health.report()
            if report["state"] != "waiting":
                world.report(f"reports {report['state']} without a device")
        world.device.start_again()
        world.device.absent = False
        world.go_on_anywhere(self._rng)
        world.begin_stream()
        world.play(0.45)
        self._answered(world.tare(), "refused", "the first reference is not complete")
        world.play_slot()
        world.play_slot()
        world.expect("reading", reference_problem="")


# Of the short form.
SHORT = (
    "tare_touched", "device_lost", "tare", "tag_off", "overflow", "tare_before_press",
    "clock_set", "disk_full", "network_cut",
)  # fmt: skip
# Events of an hour besides the losses: many times as many as anybody will see.
AN_HOUR = {
    "network_cut": 6,
    "overflow": 12,
    "slip": 2,
    "wrong_time": 2,
    "tag_off": 6,
    "tare": 6,
    "tare_touched": 6,
    "tare_before_press": 6,
    "tare_forced": 2,
    "tare_without_tag": 3,
    "clock_set": 3,
}
SLOTS_AN_HOUR = round(3600 / SLOT_S)


def schedule(hours, losses, restarts, rng):
    """Names of events by the number of their slot.

    Returns dict of int to list of str.
    """
    slots = max(round(hours * SLOTS_AN_HOUR), 1)
    names = [name for name, count in AN_HOUR.items() for _ in range(max(round(count * hours), 1))]
    in_tares = losses // 5
    names += ["device_lost"] * (losses - in_tares) + ["tare_in_loss"] * in_tares
    names += ["disk_full"] * restarts + ["stopped"] * (restarts // 3)
    due = {}
    for name in names:
        at = int(rng.integers(slots))
        due.setdefault(at, []).append(name)
        if name in ("device_lost", "tare_in_loss"):
            due.setdefault(at + int(rng.integers(1, 40)), []).append("tare")
    return due
