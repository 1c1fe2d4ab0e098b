# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a stream, and what keeps it from being read."""

import math
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import pmt
from gnuradio import gr

from ..estimation.capture.folded_groups import SnapshotGroup
from ..estimation.capture.recorded_frames import (
    ALL_FLAGGED,
    frame_problem,
    level_problem,
    snapshots_problem,
)
from ..estimation.groups import Array
from ..io.readings import Reading
from ..planning.findings import wrong_clocks
from ..planning.plan import Plan
from ..press.sensor_state import CLIPPED, PATIENCE_S, describe_doubt, describe_silence
from ..receiver.stream import StreamReader
from ..wiforce_kernels import device_settings, timeline
from ..wiforce_python import rx_time_value
from . import names


def time_value(seconds: int, fraction: float) -> Any:
    """Value of an ``rx_time`` tag as gr-uhd makes it: whole seconds (uint64) and a fraction."""
    return pmt.make_tuple(pmt.from_uint64(seconds), pmt.from_double(fraction))


class Timeline(timeline):
    """Position of items on the device's count of samples, by ``rx_time``; some are ``lost``."""

    def note_tag(self, offset: int, value: Any) -> int:
        """Take the tag of an item, of a rising index; give the samples lost just before it.

        As in ``preamble_fold``, times that are malformed or implausible are ignored, unless the
        next continues from one.
        """
        time = rx_time_value(value)
        return 0 if time is None else int(self.note(offset, *time))


def between_tags(block: Any, items: Array) -> Iterator[tuple[Array, Any]]:
    """The items of a block's first input up to each of its tags, with the tag.

    The last have none.
    """
    first, begin = block.nitems_read(0), 0
    tags = block.get_tags_in_window(0, 0, len(items))
    for tag in sorted(tags, key=lambda tag: tag.offset):
        yield items[begin : tag.offset - first], tag
        begin = tag.offset - first
    yield items[begin:], None


class DeviceSettings(device_settings):
    """Whether samples have the rate and carrier that they are read at, as in ``preamble_fold``.

    A block of this ``name`` warns where it begins to discard them.
    """

    def __init__(self, name: str, sample_rate: float, carrier: float) -> None:
        super().__init__(sample_rate, carrier)
        self._name, self._rate = name, sample_rate

    def note(self, tag: Any, takes_carrier: bool = False) -> bool:
        """Take a tag; whether samples are used again behind it, with new phases.

        ``takes_carrier``: that of the tag is used, whatever was stated.
        """
        key, value = str(tag.key), tag.value
        if key == names.RETUNED:
            return self.usable()
        if key not in (names.RX_RATE, names.RX_FREQ):
            return False
        if not (pmt.is_real(value) or pmt.is_integer(value)):
            return False
        before, is_rate, number = self.usable(), key == names.RX_RATE, pmt.to_double(value)
        (self.note_rate if is_rate else self.note_carrier)(number)
        if takes_carrier and not is_rate and self.refused_carrier() > 0:
            gr.log.warn(
                f"{self._name}: {key} is {number:g}, not {self.carrier():g}, and is recorded"
            )
            self.expect_carrier(number)
            self.note_carrier(number)
        if before and not self.usable():
            wanted = self._rate if is_rate else self.carrier()
            gr.log.warn(
                f"{self._name}: {key} is {number:g}, not {wanted:g}; samples are discarded until "
                "it is set back"
            )
        return self.usable() and not before


# Groups are looked at so often, in s of signal.
_LOOKS_S = 0.25
# Flags of readings that have a cause in the set-up if nothing else is read.
_CAUSES = {"saturated", "ambiguous", "inconsistent", "weak", "moved"}
_NO_GROUPS = (
    "every frame holds samples that are NaN or infinite, as 16-bit integers have that are read as "
    "floats; check the block that makes the samples, and its type against the input type"
)


class Folded(NamedTuple):
    """Frames made of all samples, and groups; the rate and carrier that discards them, or 0."""

    frames: int
    groups: int
    rate_hz: float = 0.0
    carrier_hz: float = 0.0


class StreamWatch:
    """Watches what passes a reader, and reports once what is wrong with it.

    The first cause that lasts for a second is said, then nothing until readings are clear: what
    follows from it would hide it. ``sampled`` excludes ratios; ``folded`` is what samples were cut
    into, before it is read.
    """

    def __init__(
        self,
        plan: Plan,
        stream: StreamReader,
        report: Callable[[str], None],
        frame_offset: int = 0,
        sampled: bool = True,
    ) -> None:
        self._plan, self._stream, self._report = plan, stream, report
        self._frame_offset, self._sampled = frame_offset, sampled
        self._frames_seen = False
        self.folded: Callable[[], Folded] | None = None
        self._quiet = False  # after a sentence, until readings are clear
        # What was said, without times: of each sensor ("": of the samples) until it is clear, and
        # ever.
        self._unclear: dict[str, set[str]] = defaultdict(set)
        self._said: set[str] = set()
        self._problem = self._level = ""
        self._since_s, self._next = 0.0, 0
        self._groups = 0
        self._readings: dict[str, list[Reading]] = {}
        self._clear: set[str] = set()
        self._begun: set[str] = set()  # sensors of whose reference was said what there is to say
        self._received_s: dict[str, float] = {}
        self._stopped = threading.Event()

    def say(self, sentence: str, sensor: str = "") -> None:
        """Report a sentence of a sensor or of the samples, unless nothing is well since another."""
        if not self._quiet:
            self._quiet = self._say_once(sentence, sensor)

    def _say_once(self, sentence: str, sensor: str) -> bool:
        """Report a sentence that was not reported since all was clear; whether it was."""
        timeless = sentence.partition(" since ")[0]
        if not sentence or timeless in self._unclear[sensor]:
            return False
        self._unclear[sensor].add(timeless)
        self._said.add(timeless)
        self._report(f"reader: {sentence}")
        return True

    def take(self, groups: Sequence[SnapshotGroup]) -> None:
        """Look at groups that have arrived."""
        self._groups += len(groups)
        for group in groups:
            if self._sampled and group.index >= self._next and group.present.any():
                self._look(group)
        if groups and not self._problem:
            self._unclear[""].clear()
        mean_frame = self._stream.mean_frame
        if not self._frames_seen and mean_frame is not None and len(frame := mean_frame()):
            self._frames_seen = True
            waveform = self._plan.waveform
            self.say(self._level or frame_problem(frame, waveform, self._frame_offset))

    def _look(self, group: SnapshotGroup) -> None:
        period_s = self._plan.group_period_s
        self._next = group.index + max(1, round(_LOOKS_S / period_s))
        folded, former = group.folded[group.present], self._problem
        self._level = level_problem(folded)
        self._problem = self._level or snapshots_problem(folded, self._plan.waveform)
        time_s = group.index * period_s
        if not former:
            self._since_s = time_s
        if self._problem and time_s - self._since_s >= PATIENCE_S:
            self.say(self._problem)

    def read(self, readings: Sequence[Reading]) -> None:
        """Look at readings."""
        for reading in readings:
            if reading.flags == ():
                self._clear.add(reading.sensor)
                self._unclear[reading.sensor].clear()
                self._quiet = False
            if reading.touch is not None:
                self._received_s[reading.sensor] = reading.time_s
            if "reference" in reading.flags and "saturated" not in reading.flags:
                continue
            if "transition" in reading.flags:
                continue  # is part of what is before it and of what follows
            known = reading.touch is not None and "ambiguous" not in reading.flags
            if known and reading.sensor not in self._begun:
                self._begun.add(reading.sensor)
                # A doubt that lasted says as much.
                if not self._stream.lasting_problem(reading.sensor):
                    touched = self._stream.counts.touched_reference().get(reading.sensor, "")
                    self._say_once(touched, reading.sensor)  # is no cause of others
            waiting = self._readings.setdefault(reading.sensor, [])
            if waiting and not _CAUSES.intersection(waiting[0].flags, reading.flags):
                waiting.clear()  # a cause that lasts for a second begins here, if there is one
            waiting.append(reading)
        for sensor, waiting in self._readings.items():
            while waiting and waiting[-1].time_s - waiting[0].time_s >= PATIENCE_S:
                # Before a problem of the samples lasts as long, that of the readings is no cause.
                if not self._problem:
                    self.say(self._cause(sensor, waiting, self._stream.lasting_problem), sensor)
                waiting.clear()

    def _cause(
        self, sensor: str, readings: Sequence[Reading], problem: Callable[[str], str]
    ) -> str:
        """What all of some readings have in common; empty where they are as they should be."""
        flags = _CAUSES.intersection(*(reading.flags for reading in readings))
        if "saturated" in flags:
            return describe_doubt(sensor, CLIPPED)
        unknown = flags and sensor not in self._clear
        if unknown and (wrong := wrong_clocks(self._stream.survey, self._plan).get(sensor)):
            return wrong
        unread = "moved" in flags and all(reading.touch is None for reading in readings)
        if ("ambiguous" in flags or unread) and (doubt := problem(sensor)):
            return describe_doubt(sensor, doubt)
        if sensor in self._clear:
            silent = "weak" in flags and all(reading.touch is None for reading in readings)
            # Otherwise: a press may be weak for long.
            return describe_silence(sensor, self._received_s[sensor]) if silent else ""
        own = next(s for s in self._plan.require_scene().sensors if s.name == sensor)
        if "inconsistent" in flags:
            file = "" if "weak" in flags else "; or the sensor file is that of another sensor"
            return (
                f"{sensor}: more than this tag is received at its clock of {own.clock_hz:g} Hz, "
                f"such as another tag with the same clock; switch it off, or change a clock{file}"
            )
        if "weak" not in flags:
            return ""
        levels = [reading.snr_db for reading in readings if reading.snr_db is not None]
        if not levels:
            return (
                f"{sensor}: no tag is found at its clock of {own.clock_hz:g} Hz; check that it is "
                "on, near and alone at this clock, and clock_hz, clock_tolerance_ppm, frame_length "
                "and sample_rate_hz of the scene"
            )
        return (
            f"{sensor}: all readings are weak (SNR {max(levels):.0f} dB); raise the transmit gain, "
            "move the antennas closer, or use longer phase groups"
        )

    def start(self) -> None:
        """Watch that groups come of the frames that arrive."""
        self._stopped.clear()
        if self.folded is not None:
            threading.Thread(target=self._wait, name="stream_watch", daemon=True).start()

    def _wait(self) -> None:
        assert self.folded is not None
        waveform = self._plan.waveform
        second = math.ceil(PATIENCE_S * waveform.sample_rate_hz / waveform.frame_length)
        former = Folded(self.folded().frames, 0)
        while not self._stopped.wait(PATIENCE_S):
            found = self.folded()
            if found.groups > former.groups:
                former = found
            elif refused := self._refusal(found):
                self.say(refused)
            elif found.frames - former.frames >= max(second, 2 * self._plan.group_length):
                self.say(_NO_GROUPS)

    def _refusal(self, folded: Folded) -> str:
        """Why samples are discarded; empty where they are not."""
        waveform, carrier_hz = self._plan.waveform, self._plan.center_frequency_hz
        for name, refused_hz, own_hz in (
            ("sample rate", folded.rate_hz, waveform.sample_rate_hz),
            ("carrier", folded.carrier_hz, carrier_hz),
        ):
            if refused_hz:
                return (
                    f"the source has a {name} of {refused_hz / 1e6:.9g} MHz, and the scene of "
                    f"{own_hz / 1e6:.9g} MHz; its samples are discarded"
                )
        return ""

    def stop(self) -> None:
        """End watching."""
        self._stopped.set()

    def end(self) -> None:
        """Say why a stream was not read, or is in doubt."""
        self.stop()
        plan, stream, group_s = self._plan, self._stream, self._plan.group_period_s
        self.say(self._problem)
        folded = Folded(0, self._groups) if self.folded is None else self.folded()
        self.say(self._refusal(folded))
        groups = max(self._groups, folded.groups)
        if not groups:
            self.say(
                _NO_GROUPS
                if folded.frames >= 2 * plan.group_length
                else f"the stream has ended without a whole phase group of {1e3 * group_s:.3g} ms "
                "behind frame_offset, at the carrier and sample rate of the scene; nothing was read"
            )
            return
        received_s, reference_s = groups * group_s, plan.reference_groups * group_s
        if received_s <= reference_s:
            self.say(
                f"the stream has ended after {received_s:.3g} s, within the untouched reference of "
                f"{reference_s:.3g} s; there are no readings beyond it"
            )
            return
        for sensor, readings in self._readings.items():
            if readings and sensor not in self._clear:
                self.say(self._cause(sensor, readings, stream.final_problem), sensor)
        for each in plan.sensors:
            doubt = (stream.lasting_problem if self._clear else stream.final_problem)(each.name)
            # One that was solved meanwhile is reported as well.
            if doubt and (report := describe_doubt(each.name, doubt)) not in self._said:
                self.say(report, each.name)
        if not self._clear:
            for wrong in wrong_clocks(stream.survey, plan).values():
                self.say(wrong)
            if self._readings:
                self.say(ALL_FLAGGED)
