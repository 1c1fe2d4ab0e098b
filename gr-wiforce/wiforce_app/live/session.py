# SPDX-License-Identifier: GPL-3.0-or-later
"""The flowgraph of the live reader: receive, align, record, read."""

import dataclasses
import math
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from gnuradio import gr, wiforce
from gnuradio.wiforce.blocks.frame_alignment import FrameSearch
from gnuradio.wiforce.blocks.sample_streams import sample_receiver
from gnuradio.wiforce.blocks.snapshots import free_fold
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture.names import second_antenna
from gnuradio.wiforce.io.capture.samples import FULL_SCALE
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.scene.schema import Scene

from ..radio.link import RadioLink
from ..radio.request import RadioRequest

# GNU Radio logs to standard output, where readings may go.
gr.logging().set_default_level(gr.log_levels.error)

_BUFFER_SAMPLES = 1 << 18
_LAST_READINGS_S = 2.0  # for the chain to process what has been received
_KEPT_BATCHES = 64
_BEHIND_S = 1.0
# Frames of a transmitter on a clock of its own drift: by 50 ppm 0.04 samples of 720 in each.
_FREE_SEARCHED_FRAMES = 50


class LiveSession:
    """Reads one device, however often it is lost; ``on_reading`` is called in a thread."""

    def __init__(
        self,
        scene: Scene,
        request: RadioRequest,
        on_reading: Callable[[Reading], None],
        tracked: bool = False,
        recording: str | Path | None = None,
    ):
        self.waveform = scene.waveform()
        self._scene, self._request = scene, request
        antennas = scene.environment.receive_antennas
        free = scene.environment.reader_clock == "free"
        self.alignment = FrameSearch(
            self.waveform, _FREE_SEARCHED_FRAMES if free else None, antennas
        )
        self.source = sample_receiver(
            request.sample_rate_hz, self.waveform.frame_length, self.alignment, antennas
        )
        self._latest = deque(maxlen=_KEPT_BATCHES)
        self.reader = wiforce.reader(
            scene,
            input_type="sc16" if antennas == 1 else "folded",
            tracked=tracked,
            on_reading=on_reading,
        )
        self.reader.groups.on_warning = lambda sentence: None  # unless a monitor takes them
        self.reader.stream.on_groups = self._latest.append
        self.recorders = []
        if recording is not None:
            names = [recording, second_antenna(recording)][:antennas]
            self.recorders = [self._make_recorder(name) for name in names]
        self._flowgraph = gr.top_block("gr-wiforce live", catch_exceptions=True)
        self._running, self._started_s = False, 0.0
        self._link, self._attached = None, 0
        self._connect()

    def _connect(self):
        self.source.set_min_output_buffer(_BUFFER_SAMPLES)
        self.fold = self.reader.fold
        if self.fold is None:  # two antennas
            self.fold = free_fold(self.waveform, self._scene.radio.center_frequency_hz)
            self._ratio = wiforce.antenna_ratio(self.waveform)
            for antenna in range(2):
                self._flowgraph.connect((self.source, antenna), (self.fold, antenna))
                self._flowgraph.connect((self.fold, antenna), (self._ratio, antenna))
            self._flowgraph.connect(self._ratio, self.reader)
        else:
            self._flowgraph.connect(self.source, self.reader)
        for antenna, recorder in enumerate(self.recorders):
            self._flowgraph.connect((self.source, antenna), recorder)

    def _make_recorder(self, path):
        from gnuradio.wiforce._config import VERSION

        scene = self._scene
        fields = {
            "core:description": "Recorded by gr-wiforce live",
            "core:recorder": f"gr-wiforce {VERSION}",
            "wiforce:scene": scene.as_dict(path),
            "wiforce:tx_amplitude": self._request.amplitude,
        }
        radio = scene.radio
        return wiforce.sigmf_recorder(
            path, radio.sample_rate_hz, radio.center_frequency_hz, "sc16", fields
        )

    def tap(self, *blocks) -> None:
        """Connect further blocks to the aligned samples of antenna 1; before `attach`."""
        self._flowgraph.connect((self.source, 0), *blocks)

    def next_request(self, request: RadioRequest) -> RadioRequest:
        """The request for the next device, which continues the frames found so far."""
        return dataclasses.replace(request, aligned=self.alignment.offset is not None)

    def attach(self, link: RadioLink) -> None:
        """Read the samples of a device that is open, after those of the devices before."""
        for recorder in self.recorders:
            settings = {f"wiforce:{key}": value for key, value in link.settings.items()}
            recorder.describe({"core:hw": link.hardware, **settings})
            if not self._running and link.clock is not None:
                recorder.utc_offset_s = link.clock[0]
        self.source.attach(link.take_samples(), link.aligned)
        self._link = link
        self._attached += 1
        if not self._running:
            self._started_s = time.monotonic()
            self._flowgraph.start()
            self._running = True

    def stop(self) -> None:
        """End in good order: `on_reading` has been called for all samples received."""
        self.source.finish()
        if self._running:
            # Of a radio that is compared only while it streams.
            if (clock := self.clock) is not None:
                for recorder in self.recorders:
                    recorder.utc_offset_s = recorder.utc_offset_s or clock[0]
            self.reader.ended.wait(_LAST_READINGS_S)
            self._flowgraph.stop()
            self._flowgraph.wait()

    @property
    def silent_s(self) -> float:
        """Seconds without a sample from the device; 0 while the reader itself is behind."""
        return 0.0 if self.behind_s > _BEHIND_S else self.source.idle_s

    @property
    def behind_s(self) -> float:
        """Seconds since the reader last asked for samples; many where an output is blocked."""
        if not self._running or self.reader.ended.is_set():
            return 0.0
        return time.monotonic() - max(self.source.called_s, self._started_s)

    @property
    def latest(self):
        """The latest groups that were read, with their clocks and SNR: a Groups."""
        return Groups.concatenate(list(self._latest))

    @property
    def clock_offsets_ppm(self) -> dict[str, float | None]:
        """Offset of every tag's clock in the latest group, by sensor; empty before the first."""
        groups = next((batch for batch in reversed(list(self._latest)) if len(batch)), None)
        if groups is None:
            return {}
        names = (each.name for each in self._scene.sensors)
        offsets_ppm = zip(names, groups.clock_offset_ppm[-1].tolist(), strict=True)
        return {name: round(ppm, 3) if math.isfinite(ppm) else None for name, ppm in offsets_ppm}

    @property
    def recording_failure(self) -> OSError | None:
        """The error that stopped a recording, or None."""
        return next((each.failure for each in self.recorders if each.failure is not None), None)

    @property
    def samples(self) -> int:
        """Number of samples received since the first frame."""
        # GNU Radio replaces the counts of a block while it starts: reading them then may crash.
        return self.source.nitems_written(0) if self._running else 0

    @property
    def time_s(self) -> float:
        """Length of the stream since the first frame, lost samples included."""
        samples = self.samples + self.fold.samples_lost() + self.fold.samples_moved()
        return samples / self._scene.radio.sample_rate_hz

    @property
    def searched_s(self) -> float:
        """Length of the samples in which no frame was found; 0 once one is found."""
        if self.alignment.offset is not None:
            return 0.0
        return self.alignment.items / self._scene.radio.sample_rate_hz

    @property
    def start_s(self) -> float | None:
        """Device time of the first frame's first sample; None before it is found."""
        time = self.alignment.start_time
        return None if time is None else time[0] + time[1]

    @property
    def clock(self) -> tuple[float, float] | None:
        """Offset of UTC from the first device's continued time and uncertainty in s, or None."""
        streams, stream_offset_s = self.source.times.stream_clock
        if self._link is None or self._link.clock is None or streams != self._attached:
            return None
        offset_s, uncertainty_s = self._link.clock
        return offset_s - stream_offset_s, uncertainty_s

    def take_peak(self) -> float:
        """Largest I or Q since the last call, over full scale."""
        peak, self.source.peak = self.source.peak, 0
        return peak / FULL_SCALE
