# SPDX-License-Identifier: GPL-3.0-or-later
"""``read --follow``: a capture that is still written. A file of its own as it needs GNU Radio."""

import queue
import signal
import threading
import time

from gnuradio import gr, wiforce
from gnuradio.wiforce.blocks.sample_files import capture_stream
from gnuradio.wiforce.estimation.capture.frame import describe_frames, searched_samples
from gnuradio.wiforce.estimation.capture.recorded_frames import find_frames, first_frame
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.capture.recordings import EmptyCapture

from ..shell.log import log
from .recordings import RoomNews, open_recording

# Its log would mix with readings on standard output; failures are raised all the same.
gr.logging().set_default_level(gr.log_levels.off)

_WAIT_S = 0.1
_END = None


class GrowingCapture:
    """Reads a capture while it grows, until interrupted; iterating gives readings as they come."""

    def __init__(self, capture, datatype, plan, frame_offset, tracked):
        recording = _once_there_are_frames(capture, datatype, plan, frame_offset is None)
        if frame_offset is None:
            frame_offset, _ = first_frame(recording, plan.waveform)
        self.frame_offset = frame_offset
        self._path = recording.path
        self._readings = queue.SimpleQueue()
        self._source = capture_stream(capture, datatype, plan.waveform.sample_rate_hz)
        _on_interrupt(self._source.ended.set)
        self._reader = wiforce.reader(
            plan, self._source.item_type, frame_offset, tracked, on_reading=self._readings.put
        )
        self._reader.groups.on_warning = log.warning

    def __iter__(self):
        flowgraph = gr.top_block("gr-wiforce read", catch_exceptions=False)
        flowgraph.connect(self._source, self._reader)
        runner = threading.Thread(target=self._run, args=(flowgraph,))
        runner.start()
        room = RoomNews()
        try:
            while (reading := self._readings.get()) is not _END:
                room.report(self._reader.findings)
                yield [reading]
        finally:
            self._source.ended.set()
            runner.join()
        for failure in (self._reader.failure, self._source.failure):
            if failure is not None:
                raise failure

    def _run(self, flowgraph):
        try:
            flowgraph.run()
        finally:
            self._readings.put(_END)

    @property
    def counts(self):
        """Group counts by outcome, so far."""
        return self._reader.counts

    @property
    def times_ignored(self):
        """Implausible ``rx_time`` tags."""
        return self._reader.fold.times_ignored()

    def suspicions(self):
        """Mistakes that the presses so far suggest, by sensor."""
        return self._reader.stream.suspicions()

    def samples_missing(self):
        """None is missing: a capture that is cut short ends the run with an error."""
        return {}

    def frames_moved(self):
        """How often the frames were found at another place than before, by file."""
        return {self._path: self._reader.fold.frames_moved()}


def open_growing(*capture):
    """What :func:`open_recording` gives, once there are samples."""
    while True:
        try:
            return open_recording(*capture)
        except EmptyCapture:
            time.sleep(_WAIT_S)


def _once_there_are_frames(capture, datatype, plan, needed):
    """The recording as soon as it is long enough and, if ``needed``, holds frames; refuses others.

    The transmitter may be switched on after the recorder.
    """
    frames = ""
    while True:
        recording = open_capture(capture, datatype)
        recording.check_against(plan.scene)
        if recording.span >= searched_samples(plan.waveform):
            if find_frames(recording, plan.waveform) is not None or not needed:
                return recording
            if not frames:
                frames = describe_frames(plan.waveform)
                log.warning(f"{recording.path}: waiting, as it holds no frames yet ({frames})")
        time.sleep(_WAIT_S)


def _on_interrupt(call):
    """Call a function when the process is asked to end; asked again, the process ends at once."""

    def end(number, _):
        signal.signal(number, signal.SIG_DFL)
        call()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
