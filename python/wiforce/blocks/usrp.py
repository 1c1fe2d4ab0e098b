# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: a USRP that sends the sounding frames of a scene and receives them, aligned."""

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.groups import Array
from ..io.capture.samples import item_type_named
from ..io.network.device_lock import DeviceLock
from ..press.sensor_state import PATIENCE_S
from ..scene import Scene, load_scene
from ..wiforce_kernels import exit_on_terminate
from .argument_types import Kept, typed
from .frame_alignment import frame_alignment
from .sounding import frame_samples
from .stream_watch import time_value

# From the first call of the transmitter to the start of both directions: a host fills the buffers
# of a device in a tenth of it.
_LEAD_S = 1.0
# The device is asked for its time once per so many seconds of samples, which costs a round trip.
_LOOK_S = 0.1
# From an underflow that is noticed to the next frame on the air: what waits between here and the
# device is discarded meanwhile, a tenth of a second at most.
_RESUME_S = 0.25
# Several times the 0.2 s for which a device was seen to pause.
_SEARCH_S = 1.0
# Samples that the receiver hands over together; single packets cost two cores at 12.5 Msps.
_TOGETHER = 1 << 16
# What finds a USRP that does not answer.
USRP_FINDER = (
    "`uhd_find_devices` lists those that do, a B210 (type=b200) needs `uhd_images_downloader`"
)
_ITEM_TYPE = "sc16"
# Whole seconds and their fraction.
DeviceTime = tuple[int, float]
# Share of a device's range at which gains begin: the software N210 then receives peaks of -10 dBFS.
_FIRST_GAIN = 1 / 3
_RATE_TOLERANCE = 1e-6


def require_rate(where: str, actual_hz: float, rate_hz: float) -> None:
    """Refuse a sample rate, of ``where`` it is stated, instead of which a device takes another."""
    if not abs(actual_hz - rate_hz) <= _RATE_TOLERANCE * rate_hz:  # nor a driver that states NaN
        rule = f"must be a rate that the device supports (nearest: {actual_hz:.9g} Hz)"
        raise InputError(where, rule, rate_hz)


def opened(open_device: Callable[[], Any], *absent: type[Exception]) -> Any:
    """The device, sought for a second: UHD waits 0.1 s for an answer, of a busy network too."""
    deadline = time.monotonic() + _SEARCH_S
    while True:
        try:
            return open_device()
        except absent:
            if time.monotonic() > deadline:
                raise


def first_gain_db(low_db: float, high_db: float) -> float:
    """The gain to begin with where a user states none: too low rather than too high."""
    return low_db + _FIRST_GAIN * (high_db - low_db)


class usrp(Kept, gr.hier_block2):
    """Both directions of a full-duplex USRP, set up by a scene.

    Sends the scene's sounding frames and receives with the same device. Both directions start at
    one device time, each time the flowgraph starts. Output: complex 16-bit samples from the first
    sample of a frame on, with the tags of gr-uhd. Where no frames are found, GNU Radio's log says
    why.

    Parameters
    ----------
    scene : str, Path or Scene
        States rate, carrier and frame.
    device : str
        Arguments of UHD, such as ``addr=192.168.10.2`` or ``type=b200``.
    tx_gain, rx_gain : float or None
        In dB; None for a third of the device's range, which is safe to begin with.
    tx_antenna, rx_antenna : str
        Ports of the device.
    amplitude : float
        Root of the mean preamble power, of full scale.

    Attributes
    ----------
    transmitter, receiver : block
        The sink and the source of gr-uhd.
    alignment : frame_alignment
        Its ``offset`` is the device's delay.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value: no such device, or one that another
        program uses, a gain outside its range, an unknown antenna or a rate that it has not.

    Examples
    --------
    >>> device = usrp("demo", "addr=192.168.10.2", rx_gain=20)  # doctest: +SKIP
    >>> flowgraph.connect(device, reader("demo", input_type="sc16"))  # doctest: +SKIP
    """

    @typed
    def __init__(
        self,
        scene: str | Path | Scene,
        device: str = "",
        tx_gain: float | None = None,
        rx_gain: float | None = None,
        tx_antenna: str = "TX/RX",
        rx_antenna: str = "RX2",
        amplitude: float = 0.5,
    ) -> None:
        scene = load_scene(scene)
        frame = frame_samples(scene.waveform().frame(), amplitude, _ITEM_TYPE)
        self._lock = DeviceLock(device, where="device")
        try:
            self._open(scene, device, tx_antenna, rx_antenna)
            self.set_tx_gain(tx_gain)
            self.set_rx_gain(rx_gain)
        except BaseException:
            self._lock.release()
            raise
        self.receiver.set_recv_timeout(0.1, False)
        self.receiver.set_max_noutput_items(_TOGETHER)
        self.alignment = frame_alignment(scene, item_type=_ITEM_TYPE)
        for block in (self.receiver, self.alignment):
            block.set_min_output_buffer(4 * _TOGETHER)
        item_bytes = item_type_named(_ITEM_TYPE).sample_bytes
        gr.hier_block2.__init__(
            self, "usrp", gr.io_signature(0, 0, 0), gr.io_signature(1, 1, item_bytes)
        )
        # Inner connections hold C++ parts only, and there is no message port: with one, GNU Radio
        # would never destroy the block, and the device would stay open.
        self._start = timed_frames(
            partial(_begin_together, self.transmitter, self.receiver),
            partial(device_time_of, self.transmitter),
            frame,
            scene.radio.sample_rate_hz,
            watches=True,
        )
        self.connect(self._start.gateway, self.transmitter)
        self.connect(self.receiver, self.alignment.gateway, self._impl)

    def _open(self, scene: Scene, device: str, tx_antenna: str, rx_antenna: str) -> None:
        """Open the device, and set all but its gains."""
        from gnuradio import uhd

        stream = uhd.stream_args(cpu_format=_ITEM_TYPE, otw_format=_ITEM_TYPE, channels=[0])
        absent = RuntimeError, LookupError, ValueError
        try:
            self.transmitter = opened(lambda: uhd.usrp_sink(device, stream), *absent)
            # The receiver waits for the command that starts both.
            self.receiver = opened(lambda: uhd.usrp_source(device, stream, False), *absent)
        except absent as error:
            text = str(error)
            last = text.strip().splitlines()[-1].strip()
            reason = "no device found" if "No devices found" in text else last
            rule = (
                f"must be a USRP that answers ({reason}): {USRP_FINDER}, and `gr-wiforce emulate` "
                "stands in"
            )
            # The trace of UHD's own error would hide this sentence.
            raise InputError("device", rule, device) from None
        self._lock.take_serial(self.transmitter.get_usrp_info().get("mboard_serial"))
        for direction, end, antenna in (
            ("tx", self.transmitter, tx_antenna),
            ("rx", self.receiver, rx_antenna),
        ):
            if antenna not in end.get_antennas():
                rule = f"must be one of {', '.join(end.get_antennas())}"
                raise InputError(f"{direction}_antenna", rule, antenna)
            end.set_antenna(antenna)
            end.set_samp_rate(scene.radio.sample_rate_hz)
            where = f"{scene.path or 'scene'}: radio.sample_rate_hz"
            require_rate(where, end.get_samp_rate(), scene.radio.sample_rate_hz)
            end.set_center_freq(scene.radio.center_frequency_hz)

    @typed
    def set_tx_gain(self, gain_db: float | None) -> None:
        """Change the gain of the transmitter, in dB; None for a third of its range."""
        _set_gain("tx_gain", self.transmitter, gain_db)

    @typed
    def set_rx_gain(self, gain_db: float | None) -> None:
        """Change the gain of the receiver, in dB; None for a third of its range."""
        _set_gain("rx_gain", self.receiver, gain_db)

    def gain_sliders(self) -> Any:
        """A Qt widget with both gains, each over the range of the device."""
        from gnuradio.qtgui import Range, RangeWidget
        from PyQt5.QtCore import Qt
        from PyQt5.QtWidgets import QHBoxLayout, QWidget

        widget, horizontal = QWidget(), Qt.Orientation.Horizontal
        row = QHBoxLayout(widget)
        for label, end, change in (
            ("Transmit gain (dB)", self.transmitter, self.set_tx_gain),
            ("Receive gain (dB)", self.receiver, self.set_rx_gain),
        ):
            limits = end.get_gain_range()
            # A gain of the device is a multiple of its step; half of a dB where it states none.
            scale = Range(limits.start(), limits.stop(), limits.step() or 0.5, end.get_gain(), 200)
            row.addWidget(RangeWidget(scale, change, label, "counter_slider", float, horizontal))
        return widget


def _set_gain(parameter: str, end: Any, gain_db: float | None) -> None:
    limits = end.get_gain_range()
    low, high = limits.start(), limits.stop()
    if gain_db is None:
        gain_db = first_gain_db(low, high)
    if not low <= gain_db <= high:
        raise InputError(parameter, f"must be {low:g} to {high:g} dB with this device", gain_db)
    end.set_gain(gain_db)


def device_time_of(end: Any) -> DeviceTime:
    """Whole seconds and fraction of the clock of a source or sink of gr-uhd."""
    now = end.get_time_now()
    return now.get_full_secs(), now.get_frac_secs()


def _begin_together(transmitter: Any, receiver: Any) -> DeviceTime:
    """Schedule the receiver, and return the time at which both ends start."""
    from gnuradio import uhd

    start = transmitter.get_time_now() + uhd.time_spec(_LEAD_S)
    command = uhd.stream_cmd(uhd.stream_mode.STREAM_MODE_START_CONTINUOUS)
    command.stream_now = False
    command.time_spec = start
    receiver.issue_stream_cmd(command)
    return start.get_full_secs(), start.get_frac_secs()


# Samples that a transmitter is given together; it takes packets, and called after each of them,
# a Python block takes a quarter of a core.
_SENT_TOGETHER = _TOGETHER // 2


class timed_frames(Kept, gr.sync_block):
    """Gives sounding frames (n, 2), complex 16-bit, to a transmitter of gr-uhd with their times.

    After an underflow all packets are late and discarded (UHD manual, "Error Codes"), so that times
    begin anew, later by whole frames, ``skipped_s`` in all. ``begin`` gives the time of a run's
    first sample, ``device_time`` the present one; ``watches``: says when the device is lost.
    """

    def __init__(
        self,
        begin: Callable[[], DeviceTime],
        device_time: Callable[[], DeviceTime],
        frame: Array,
        sample_rate: float,
        watches: bool = False,
    ) -> None:
        item = item_type_named(_ITEM_TYPE).item
        gr.sync_block.__init__(self, "timed_frames", in_sig=None, out_sig=[item])
        self._begin, self._device_time = begin, device_time
        self._frame_length, self._sample_rate = len(frame), sample_rate
        # From any sample of a frame on, there are as many as are given together.
        self._frames = np.tile(frame, (1 + math.ceil(_SENT_TOGETHER / len(frame)), 1))
        self._first: int | None = None
        self._start: DeviceTime = (0, 0.0)
        self._skipped = self._next_look = 0  # in samples
        self._watches, self._stopped = watches, threading.Event()
        self.set_output_multiple(_SENT_TOGETHER)
        self.set_min_output_buffer(2 * _TOGETHER)

    @property
    def skipped_s(self) -> float:
        return self._skipped / self._sample_rate

    def start(self) -> bool:
        self._first, self._skipped, self._next_look = None, 0, 0
        self._stopped.clear()
        if self._watches:
            self._watching = threading.Thread(target=self._watch, name="device_watch", daemon=True)
            self._watching.start()
        return super().start()

    def stop(self) -> bool:
        self._stopped.set()
        if self._watches:
            self._watching.join()  # or it might keep the device open as the process ends
        return super().stop()

    def _watch(self) -> None:
        """Ask the device for its time once a second; two failures in a row say that it is lost."""
        silent = 0
        while silent < 2:
            if self._stopped.wait(PATIENCE_S):
                return
            try:
                self._device_time()
            except RuntimeError:
                silent += 1
            else:
                silent = 0
        gr.log.error(
            "usrp: the device is lost, it does not answer; check its cable and its power, and "
            "start the program again"
        )
        # An exit status; else the program ends with a trace of memory addresses when stopped.
        exit_on_terminate(1)

    def work(self, _: list[Array], output_items: list[Array]) -> int:
        now, out = self.nitems_written(0), output_items[0][:_SENT_TOGETHER]
        if self._first is None:
            self._first, self._start = now, self._begin()
            self._tag(now)
        elif now >= self._next_look:
            self._look(now)
        start = (now - self._first) % self._frame_length
        out[:] = self._frames[start : start + len(out)]
        return len(out)

    def _look(self, item: int) -> None:
        """Let times begin anew where those of the samples have passed."""
        self._next_look = item + round(_LOOK_S * self._sample_rate)
        try:
            device = self._device_time()
        except RuntimeError:  # UHD's, where the device does not answer in time: it is asked again
            return
        due = self._time_of(item)
        late_s = device[0] - due[0] + device[1] - due[1]
        if late_s > 0:
            frame_s = self._frame_length / self._sample_rate
            frames = math.ceil((late_s + _RESUME_S) / frame_s)
            self._skipped += frames * self._frame_length
            self._tag(item)
            gr.log.warn(
                f"transmit underflow: nothing was sent for {frames * frame_s:.2f} s; frames go on "
                "where receivers expect them (this machine is too slow for the sample rate)"
            )

    def _tag(self, item: int) -> None:
        self.add_item_tag(0, item, pmt.intern("tx_time"), time_value(*self._time_of(item)))

    def _time_of(self, item: int) -> DeviceTime:
        assert self._first is not None
        passed_s = (item - self._first + self._skipped) / self._sample_rate
        whole = math.floor(self._start[1] + passed_s)
        return self._start[0] + whole, self._start[1] + passed_s - whole
