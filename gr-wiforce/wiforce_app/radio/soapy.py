# SPDX-License-Identifier: GPL-3.0-or-later
"""The driver ``soapy``: any radio with a SoapySDR module, through GNU Radio's Soapy blocks."""

import contextlib
import math
import os
import sys
import time

from gnuradio.wiforce.errors import InputError

from .radio import End, Radio, absent_rule, last_line, set_environment
from .request import DeviceAbsent

# SoapyUHD passes on what UHD says; see uhd.py.
_QUIET = {
    "SOAPY_SDR_LOG_LEVEL": "FATAL",
    "UHD_LOG_CONSOLE_LEVEL": "fatal",
    "UHD_LOG_FASTPATH_DISABLE": "1",
}
_PACKAGES = "GNU Radio's gr-soapy (libgnuradio-soapy) and python3-soapysdr"
_NANO = 1e-9
_DRIVER_ERRORS = (RuntimeError, ValueError, LookupError, ArithmeticError)
# What samples may be late by when they arrive: buffers of drivers hold less.
_LATE_S = 1.0


class SoapyRadio(Radio):
    """A SoapySDR device. Its blocks start streams at once, not at a given time."""

    starts_together = False
    # Drivers scale complex floats to 1; 16-bit integers have the range of the converter, such as
    # +-2048, which only some state (SoapySDR issue 376).
    item_type = "fc32"
    # SoapySDR has no exceptions of its own: drivers throw any for settings, RuntimeError mostly.
    refusals = _DRIVER_ERRORS
    _is_checked = False

    def _open(self, request):
        soapy, library = _libraries()
        _keep_standard_error()
        self._opened, args = [], request.args
        for given in (("--args", args), request.transmitter):
            _check_arguments(*given)
        device = self._device(library, "--args", args)
        with self._asking("--args", args):
            _check_receiver(library, device, args, request.antennas)
            self.serials = [_serial(device)]
        receiver = self._end(soapy.source, "--args", args, request.antennas)
        transmitter = None
        if not request.receive_only:
            option, other = request.transmitter
            other_device = self._device(library, option, other)
            with self._asking(option, other):
                _check_transmitter(library, other_device, option, other, other == args)
                self.serials.append(_serial(other_device))
            transmitter = self._end(soapy.sink, option, other)
        self._clocks = [receiver.block]
        if request.tx_args is not None:
            self._clocks.append(transmitter.block)
        with self._asking("--args", args):
            self.has_time = receiver.block.has_hardware_time("")
            if self.has_time:
                receiver.block.get_hardware_time("")
            kind = f"{device.getHardwareKey()} (driver {device.getDriverKey()})"
        self.hardware = ", ".join(text for text in (_text(kind), self.serials[0]) if text)
        return receiver, transmitter

    def _asking(self, option, args):
        return self.applying(option, args, rule="must name a device that states what it can do")

    def _end(self, kind, option, args, channels=1):
        try:
            block = kind(args, self.item_type, channels, "", "", [""], [""])
        except _DRIVER_ERRORS as error:
            raise DeviceAbsent(option, _absent(error), args) from error
        rule = "must name a device whose automatic gain control can be switched off"
        with self.applying(option, args, rule=rule):
            return _SoapyEnd(block, channels)

    def _device(self, library, option, args):
        """The device that the blocks use, for what they do not report; opened once for all."""
        try:
            self._opened.append(library.Device(args))
        except _DRIVER_ERRORS as error:
            raise DeviceAbsent(option, _absent(error), args) from error
        return self._opened[-1]

    def _clock_sources(self):
        return list(self.source.list_clock_sources())

    def _set_clock_source(self, name):
        for block in self._clocks:
            block.set_clock_source(name)

    @property
    def time_s(self):
        if not self.has_time:
            return time.monotonic()
        return self.source.get_hardware_time("") * _NANO

    def accepts_time(self, time_s):
        # gr-soapy tags what a driver leaves in the time, which may be nothing.
        if self.has_time and not self._is_checked:
            self.has_time = abs(self.time_s - time_s) < _LATE_S
        self._is_checked = True
        return self.has_time

    def start_together(self, lead_s):
        return self.time_s


class _SoapyEnd(End):
    """Source or sink of gr-soapy."""

    def __init__(self, block, channels=1):
        super().__init__(block, channels)
        for channel in self._channels:
            # A gain that changes by itself changes the phases as a press does.
            if block.has_gain_mode(channel):
                block.set_gain_mode(channel, False)

    def set(self, name, value):
        for channel in self._channels:
            getattr(self.block, f"set_{name}")(channel, value)

    def set_rate(self, rate_hz):
        nearest = _nearest(self.block.get_sample_rate_range(0), rate_hz)
        if not math.isclose(nearest, rate_hz, rel_tol=1e-6):
            return nearest
        self.set("sample_rate", nearest)
        return self.block.get_sample_rate(0)

    def set_carrier(self, carrier_hz):
        if _nearest(self.block.get_frequency_range(0), carrier_hz) != carrier_hz:
            return math.inf
        self.set("frequency", carrier_hz)
        return self.block.get_frequency(0)

    def limits(self, name):
        ranges = getattr(self.block, f"get_{'frequency' if name == 'carrier' else name}_range")(0)
        if name == "gain":
            ranges = [ranges]
        elif name == "bandwidth" and not ranges:
            return None
        return min(each.minimum() for each in ranges), max(each.maximum() for each in ranges)

    def antennas(self):
        return list(self.block.list_antennas(0))

    def locked(self):
        with contextlib.suppress(*_DRIVER_ERRORS):
            if "lo_locked" in self.block.list_sensors(0):
                return str(self.block.read_sensor(0, "lo_locked")).lower() == "true"
        return True


def _libraries():
    """GNU Radio's blocks, and SoapySDR itself."""
    set_environment(_QUIET)
    try:
        import SoapySDR
        from gnuradio import soapy
    except ImportError as error:
        raise InputError("--driver", f"'soapy' needs {_PACKAGES} ({last_line(error)})") from error
    return soapy, SoapySDR


def _keep_standard_error():
    """Discard what libraries print, such as letters for losses; keep what Python prints."""
    kept, discarded = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(discarded, 2)
    os.close(discarded)
    # By lines, as Python's own: the process may end without writing what waits.
    sys.stderr = open(kept, "w", 1, encoding="utf-8", errors="backslashreplace")


def _serial(device):
    """The serial number that a device states, or nothing."""
    info = dict(device.getHardwareInfo())
    keys = sorted(key for key in info if key.lower().endswith("serial"))
    return _text(info[keys[0]]) if keys else ""


def _check_arguments(option, args):
    """Refuse arguments that name no module."""
    pairs = (pair.partition("=") for pair in args.split(","))
    if not {key.strip(): value.strip() for key, _, value in pairs}.get("driver"):
        rule = "must name the SoapySDR module, as driver=lime (`SoapySDRUtil --find` lists devices)"
        raise InputError(option, rule, args)


def _check_receiver(library, device, args, antennas):
    channels = device.getNumChannels(library.SOAPY_SDR_RX)
    if channels < antennas:
        rule = f"must name a device with {antennas} receive channel{'s' * (antennas > 1)}"
        raise InputError("--args", f"{rule} (it has {channels})", args)


def _check_transmitter(library, device, option, args, receives):
    if device.getNumChannels(library.SOAPY_SDR_TX) == 0:
        raise InputError(option, "must name a full-duplex device: this one receives only", args)
    if receives and not device.getFullDuplex(library.SOAPY_SDR_TX, 0):
        rule = "must name a full-duplex device: this one transmits or receives, but not both"
        raise InputError(option, f"{rule} at once", args)


def _absent(error):
    text = str(error)
    reason = last_line(error)
    if "No devices found" in text:
        reason = "no device found"
    if "no match" in text:
        reason = "no device found; is the SoapySDR module of this driver installed?"
    return absent_rule(reason, "`SoapySDRUtil --find` lists those that do")


def _text(text):
    """What a driver states, which may be no UTF-8: other bytes as in ``\\xff``."""
    return text.encode(errors="surrogateescape").decode(errors="backslashreplace")


def _nearest(ranges, value):
    """The value within ranges that is nearest to one."""
    return min(
        (min(max(value, each.minimum()), each.maximum()) for each in ranges),
        key=lambda each: abs(each - value),
        default=value,
    )
