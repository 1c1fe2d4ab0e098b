# SPDX-License-Identifier: GPL-3.0-or-later
"""A UHD device, opened and set up for a scene; every refusal is one line."""

import os
import time

from gnuradio.wiforce.errors import InputError

from .radio_request import DeviceAbsent, RadioRequest

# UHD prints dozens of lines that would hide our own. Users who need them set these variables.
_QUIET = {"UHD_LOG_CONSOLE_LEVEL": "fatal", "UHD_LOG_FASTPATH_DISABLE": "1"}
_LOCK_S = 1.0
_RATE_TOLERANCE = 1e-6
_CARRIER_TOLERANCE_HZ = 10.0


class Radio:
    """One transmit and one receive channel of a device, 16-bit integers both ways.

    Parameters
    ----------
    request : RadioRequest

    Attributes
    ----------
    source, sink : uhd blocks
    hardware : str
        Kind, daughterboard and serial number of the device.
    serial : str
        Serial number alone; empty when the device states none.

    Raises
    ------
    DeviceAbsent
        When there is no such device.
    InputError
        When it does not support a setting.
    """

    def __init__(self, request: RadioRequest):
        self.source, self.sink = _open(request.args)
        self._name = request.scene_name
        if request.reference is not None:
            self._set_reference(request.reference)
        for block in (self.sink, self.source):
            self._set_rate(block, request.sample_rate_hz)
            self._set_carrier(block, request.center_frequency_hz)
        _set_gain("--tx-gain", self.sink, request.tx_gain_db)
        _set_gain("--rx-gain", self.source, request.rx_gain_db)
        _set_antenna("--tx-antenna", self.sink, request.tx_antenna)
        _set_antenna("--antenna", self.source, request.rx_antenna)
        self.hardware = _describe(self.source)
        self.serial = self.source.get_usrp_info().get("mboard_serial")

    def unlocked(self) -> list[str]:
        """Directions (``tx``, ``rx``) whose oscillator has not locked after a second."""
        blocks = {"tx": self.sink, "rx": self.source}
        return [direction for direction, block in blocks.items() if not _locks(block)]

    @property
    def time_s(self) -> float:
        """Device time."""
        return self.source.get_time_now().get_real_secs()

    def start_together(self, lead_s: float) -> float:
        """Schedule both streams to start `lead_s` from now.

        Parameters
        ----------
        lead_s : float

        Returns
        -------
        float
            Device time of the start.
        """
        from gnuradio import uhd

        start_s = self.time_s + lead_s
        for block in (self.source, self.sink):
            block.set_start_time(uhd.time_spec(start_s))
        return start_s

    def settings(self) -> dict:
        """Gains and antennas as plain values for metadata."""
        return {
            "tx_gain_db": self.sink.get_gain(),
            "rx_gain_db": self.source.get_gain(),
            "tx_antenna": self.sink.get_antenna(),
            "rx_antenna": self.source.get_antenna(),
        }

    def _set_rate(self, block, rate_hz):
        block.set_samp_rate(rate_hz)
        actual = block.get_samp_rate()
        if abs(actual - rate_hz) > _RATE_TOLERANCE * rate_hz:
            rule = f"must be a rate that the device supports (nearest: {actual:.9g} Hz)"
            raise InputError(f"{self._name}: radio.sample_rate_hz", rule, rate_hz)

    def _set_carrier(self, block, carrier_hz):
        block.set_center_freq(carrier_hz)
        if abs(block.get_center_freq() - carrier_hz) > _CARRIER_TOLERANCE_HZ:
            limits = block.get_freq_range()
            low, high = limits.start() / 1e6, limits.stop() / 1e6
            rule = f"must lie in the device's range, {low:.6g} to {high:.6g} MHz"
            raise InputError(f"{self._name}: radio.center_frequency_hz", rule, carrier_hz)

    def _set_reference(self, reference):
        known = self.source.get_clock_sources(0)
        if reference not in known:
            raise InputError("--reference", f"must be one of {', '.join(known)}", reference)
        self.source.set_clock_source(reference)


def _open(args):
    for name, value in _QUIET.items():  # read by UHD when it is loaded
        os.environ.setdefault(name, value)
    from gnuradio import uhd

    stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0])
    try:
        blocks = uhd.usrp_source(args, stream), uhd.usrp_sink(args, stream)
    except (RuntimeError, ValueError, IndexError, KeyError) as error:
        reason = "no device found" if "No devices found" in str(error) else _last_line(error)
        rule = (
            f"must name a device that answers ({reason}); without a device, use "
            "`gr-wiforce emulate`, or `gr-wiforce read` for recordings"
        )
        raise DeviceAbsent("--args", rule, args) from error
    for block in blocks:
        block.set_log_level("off")  # the reader reports gaps
    return blocks


def _last_line(error):
    lines = str(error).strip().splitlines()
    return lines[-1].strip() if lines else type(error).__name__


def _set_gain(option, block, gain_db):
    if gain_db is None:
        return
    limits = block.get_gain_range()
    if not limits.start() <= gain_db <= limits.stop():
        rule = f"must be {limits.start():g} to {limits.stop():g} dB with this device"
        raise InputError(option, rule, gain_db)
    block.set_gain(gain_db)


def _set_antenna(option, block, antenna):
    if antenna is None:
        return
    known = block.get_antennas()
    if antenna not in known:
        raise InputError(option, f"must be one of {', '.join(known)}", antenna)
    block.set_antenna(antenna)


def _locks(block):
    if "lo_locked" not in block.get_sensor_names():
        return True
    deadline = time.monotonic() + _LOCK_S
    while not block.get_sensor("lo_locked").to_bool():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def _describe(source):
    info = source.get_usrp_info()
    known = [info.get(key) for key in ("mboard_id", "rx_subdev_name", "mboard_serial")]
    return ", ".join(text for text in known if text)
