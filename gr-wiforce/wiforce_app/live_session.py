# SPDX-License-Identifier: GPL-3.0-or-later
"""The flowgraph of the live reader: transmit, receive, align, record, read."""

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from gnuradio import gr, wiforce
from gnuradio.wiforce.blocks.level_meter import level_meter
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.io.samples import FULL_SCALE
from gnuradio.wiforce.scene.schema import Scene

from .radio import Radio

# GNU Radio logs to standard output, where readings may go.
gr.logging().set_default_level(gr.log_levels.error)

# How far ahead the common start is set. A busy machine may miss it; then the next one is tried.
_START_LEADS_S = (0.5, 1.5, 4.0)
_START_GRACE_S = 1.0
_START_LOOK_S = 0.02
_BUFFER_SAMPLES = 1 << 18
# Samples that are received at once, as a time, by the option --latency. Handling every packet by
# itself would cost two cores.
RECEIVE_S = {"low": 2e-3, "relaxed": 20e-3}
_MOST_RECEIVE_SAMPLES = 1 << 17  # half the buffer
_RECEIVE_TIMEOUT_S = 0.1
_LAST_READINGS_S = 2.0  # for the chain to process what has been received
_KEPT_BATCHES = 64


class DeviceLost(Exception):
    """The device sends no samples, or has stopped sending them."""


class LiveSession:
    """Transmits and reads with one device.

    Parameters
    ----------
    scene : Scene
    radio : Radio
    on_reading : callable
        Called with every Reading as soon as it is ready, in another thread.
    amplitude : float
        Root of the mean preamble power of the transmitted signal, over full scale.
    tracked : bool
        Track each press over time.
    recording : str or Path, optional
        Record to this SigMF pair.
    latency : str
        How many samples are received at once, a key of ``RECEIVE_S``.
    """

    def __init__(
        self,
        scene: Scene,
        radio: Radio,
        on_reading: Callable[[Reading], None],
        amplitude: float = 0.5,
        tracked: bool = False,
        recording: str | Path | None = None,
        latency: str = "low",
    ):
        self.waveform = waveform = scene.waveform()
        sounding = {
            "waveform": waveform.name,
            "frame_length": waveform.frame_length,
            "sample_rate": waveform.sample_rate_hz,
            "item_type": "sc16",
        }
        self._scene, self._radio = scene, radio
        self._transmitted = wiforce.sounding_source(amplitude=amplitude, **sounding)
        self.alignment = wiforce.frame_alignment(**sounding)
        self.meter = level_meter()
        self._latest = deque(maxlen=_KEPT_BATCHES)
        self.reader = wiforce.reader(
            scene,
            input_type="sc16",
            tracked=tracked,
            on_reading=on_reading,
        )
        self.reader.groups.stream.on_groups = self._latest.append
        self.recorder = self._make_recorder(recording, amplitude) if recording is not None else None
        # UHD's blocks throw when a device disappears, which must not end the process.
        self._flowgraph = gr.top_block("gr-wiforce live", catch_exceptions=True)
        self._connect(RECEIVE_S[latency])

    def _connect(self, receive_s):
        radio, flowgraph = self._radio, self._flowgraph
        radio.source.set_recv_timeout(_RECEIVE_TIMEOUT_S, False)
        received = int(receive_s * self.waveform.sample_rate_hz)
        radio.source.set_max_noutput_items(min(received, _MOST_RECEIVE_SAMPLES))
        for block in (radio.source, self.alignment, self.meter):
            block.set_min_output_buffer(_BUFFER_SAMPLES)
        flowgraph.connect(self._transmitted, radio.sink)
        flowgraph.connect(radio.source, self.alignment, self.meter, self.reader)
        if self.recorder is not None:
            self.tap(self.recorder)

    def _make_recorder(self, path, amplitude):
        from gnuradio.wiforce._config import VERSION

        scene = self._scene
        fields = {
            "core:description": "Recorded by gr-wiforce live",
            "core:recorder": f"gr-wiforce {VERSION}",
            "core:hw": self._radio.hardware,
            "core:extensions": [{"name": "wiforce", "version": VERSION, "optional": True}],
            "wiforce:scene": scene.as_dict(),
            "wiforce:tx_amplitude": amplitude,
            **{f"wiforce:{key}": value for key, value in self._radio.settings().items()},
        }
        radio = scene.radio
        return wiforce.sigmf_recorder(
            path, radio.sample_rate_hz, radio.center_frequency_hz, "sc16", fields
        )

    def tap(self, *blocks) -> None:
        """Connect further blocks to the aligned samples; before `start`."""
        self._flowgraph.connect(self.alignment, *blocks)

    def start(self) -> None:
        """Start both streams at one device time.

        Raises
        ------
        DeviceLost
            When the device sends no samples.
        """
        for lead_s in _START_LEADS_S:
            start_s = self._radio.start_together(lead_s)
            self._flowgraph.start()
            if self._receives_after(start_s):
                return
            self._flowgraph.stop()
            self._flowgraph.wait()
        raise DeviceLost(f"{self._radio.hardware}: sends no samples; check its network and power")

    def _receives_after(self, start_s):
        """Whether samples arrive soon after this device time."""
        try:
            while self.samples_received == 0:
                if self._radio.time_s > start_s + _START_GRACE_S:
                    return False
                time.sleep(_START_LOOK_S)
        except RuntimeError as error:  # UHD's, when the device does not answer
            raise DeviceLost(f"{self._radio.hardware}: does not answer any more") from error
        return True

    def stop(self) -> None:
        """End in good order: `on_reading` has been called for all samples received."""
        self.meter.end()
        if self.samples:
            self.reader.ended.wait(_LAST_READINGS_S)
        self._flowgraph.stop()
        self._flowgraph.wait()

    def read_rest(self) -> None:
        """Read the groups held back when the device is lost, since it cannot be stopped then."""
        self.reader.groups.end()

    @property
    def latest(self):
        """The latest groups that were read, with their clocks and SNR: a Groups."""
        return Groups.concatenate(list(self._latest))

    @property
    def failure(self):
        """The exception that ended the chain, or None."""
        return self.reader.failure

    @property
    def samples(self) -> int:
        """Number of samples received since the first frame."""
        return self.meter.nitems_read(0)

    @property
    def samples_received(self) -> int:
        """Number of samples received, those before the first frame included."""
        return self.alignment.nitems_read(0)

    @property
    def samples_lost(self) -> int:
        """Number of samples that gaps account for."""
        return self.reader.fold.samples_lost()

    @property
    def gaps(self) -> int:
        """Number of gaps in the stream."""
        return self.reader.fold.gaps()

    @property
    def frames_moved(self) -> int:
        """Times that the frame timing shifted without an ``rx_time`` tag."""
        return self.reader.fold.frames_moved()

    @property
    def times_ignored(self) -> int:
        """Number of implausible ``rx_time`` tags."""
        return self.reader.fold.times_ignored()

    @property
    def time_s(self) -> float:
        """Length of the stream since the first frame, lost samples included."""
        samples = self.samples + self.samples_lost + self.reader.fold.samples_moved()
        return samples / self._scene.radio.sample_rate_hz

    @property
    def start_s(self) -> float | None:
        """Device time of the first frame's first sample; None before it is found."""
        time = self.alignment.start_time
        return None if time is None else time[0] + time[1]

    def take_peak(self) -> float:
        """Largest I or Q since the last call, over full scale."""
        peak, self.meter.peak = self.meter.peak, 0
        return peak / FULL_SCALE
