# SPDX-License-Identifier: GPL-3.0-or-later
"""The driver ``uhd``: a USRP, through GNU Radio's UHD blocks."""

from gnuradio.wiforce.blocks.usrp import USRP_FINDER, first_gain_db

from .radio import End, Radio, absent_rule, last_line, set_environment
from .request import DeviceAbsent

# UHD prints dozens of lines that would hide our own. Users who need them set these variables.
_QUIET = {"UHD_LOG_CONSOLE_LEVEL": "fatal", "UHD_LOG_FASTPATH_DISABLE": "1"}


class UhdRadio(Radio):
    """A UHD device; both streams start at one device time."""

    def _open(self, request):
        set_environment(_QUIET)
        from gnuradio import uhd

        receiver = _UhdEnd(_block(uhd.usrp_source, "--args", request.args, request.antennas))
        transmitter = None
        if not request.receive_only:
            transmitter = _UhdEnd(_block(uhd.usrp_sink, *request.transmitter))
        self._apart = request.tx_args is not None
        self.starts_together = not self._apart and not request.receive_only
        info = receiver.block.get_usrp_info()
        known = [info.get(key) for key in ("mboard_id", "rx_subdev_name", "mboard_serial")]
        self.hardware = ", ".join(text for text in known if text)
        ends = [receiver] if transmitter is None else [receiver, transmitter]
        self.serials = [end.block.get_usrp_info().get("mboard_serial") for end in ends]
        return receiver, transmitter

    def _set_first_gain(self, end):
        end.set("gain", first_gain_db(*end.limits("gain")))

    def _clock_sources(self):
        return self.source.get_clock_sources(0)

    def _set_clock_source(self, name):
        self.source.set_clock_source(name)
        if self._apart:
            self.sink.set_clock_source(name)

    @property
    def time_s(self):
        return self.source.get_time_now().get_real_secs()

    def start_together(self, lead_s):
        from gnuradio import uhd

        start_s = self.time_s + lead_s
        # The time of another device is not known: its transmitter starts at once.
        for block in (self.source, None if self._apart else self.sink):
            if block is not None:
                block.set_start_time(uhd.time_spec(start_s))
        return start_s

    def collect(self, samples, timeout_s):
        self.source.set_recv_timeout(timeout_s, False)
        self.source.set_max_noutput_items(samples)
        return True


class _UhdEnd(End):
    """Source or sink of gr-uhd."""

    def __init__(self, block):
        super().__init__(block, block.output_signature().min_streams() or 1)

    def set(self, name, value):
        for channel in self._channels:
            getattr(self.block, f"set_{name}")(value, channel)

    def set_rate(self, rate_hz):
        self.block.set_samp_rate(rate_hz)
        return self.block.get_samp_rate()

    def set_carrier(self, carrier_hz):
        self.set("center_freq", carrier_hz)
        return self.block.get_center_freq()

    def limits(self, name):
        values = getattr(self.block, f"get_{'freq' if name == 'carrier' else name}_range")()
        return values.start(), values.stop()

    def antennas(self):
        return list(self.block.get_antennas())

    def locked(self):
        if "lo_locked" not in self.block.get_sensor_names():
            return True
        return self.block.get_sensor("lo_locked").to_bool()


def _block(kind, option, args, channels=1):
    from gnuradio import uhd

    stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=list(range(channels)))
    try:
        block = kind(args, stream)
    except (RuntimeError, ValueError, IndexError, KeyError) as error:
        reason = "no device found" if "No devices found" in str(error) else last_line(error)
        if "driver=" in args:
            reason = "no device found; driver= names a SoapySDR module, with --driver soapy"
        raise DeviceAbsent(option, absent_rule(reason, USRP_FINDER), args) from error
    block.set_log_level("off")  # the reader reports gaps
    return block
