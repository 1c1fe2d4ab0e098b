# SPDX-License-Identifier: GPL-3.0-or-later
"""Slow control: discovery, frame-size search, EEPROMs and registers; a reply per request."""

import struct

from ..wire import READBACK_BASE, SETTINGS_BASE, Malformed

PROTOCOL_VERSION = 12
_HEAD = struct.Struct(">III")
_MESSAGE_SIZE = 36
_MAX_FRAME = 9000
_PEEK_FIRMWARE, _POKE_FIRMWARE = 5, 6
_PEEKS, _POKES = (1, 2), (3, 4)
_FIRMWARE_LOCK_TIME, _FIRMWARE_LOCK_OWNER = 0, 1
_FIRMWARE_HAS_GPSDO = 3
_FIRMWARE_MINOR = 7
_NO_GPSDO = 0x1234ABCD


class Control:
    """Answers requests on the control port.

    ``on_close``: called when the host releases its lock, which it does when it closes the device.
    """

    def __init__(self, registers, bus, on_close=lambda: None):
        self._registers = registers
        self._bus = bus
        self._on_close = on_close
        self._firmware = {_FIRMWARE_HAS_GPSDO: _NO_GPSDO, _FIRMWARE_MINOR: 4}
        self._handlers = {
            "a": self._hello,
            "l": self._echo,
            "i": self._i2c_read,
            "h": self._i2c_write,
            "s": lambda body, _: body,
            "r": self._register,
        }

    def reply(self, request):
        """The reply to a datagram, or None when there is none.

        Raises Malformed when it does not follow this protocol.
        """
        if len(request) < _MESSAGE_SIZE:
            if len(request) == 16:
                return None  # the X300 driver searches for its devices at this port
            raise Malformed(f"control request of {len(request)} bytes")
        version, code, sequence = _HEAD.unpack_from(request)
        # A host that does not know our version yet is sent a hello, whatever it requested.
        name = chr(code & 0x7F) if version == PROTOCOL_VERSION else "a"
        handler = self._handlers.get(name)
        if handler is None:
            return _HEAD.pack(PROTOCOL_VERSION, ord(" "), sequence) + bytes(24)
        body = handler(request[12:_MESSAGE_SIZE], request)
        if body is None:
            return None
        head = _HEAD.pack(PROTOCOL_VERSION, ord(name.upper()), sequence)
        return head + body.ljust(24, b"\0")

    def _hello(self, body, _):
        return bytes(24)

    def _echo(self, body, request):
        wanted = struct.unpack_from(">I", body)[0]
        if max(wanted, len(request)) > _MAX_FRAME:
            return None
        return struct.pack(">I", len(request)).ljust(max(wanted - 12, 24), b"\0")

    def _i2c_read(self, body, _):
        address, count = body[0], body[1]
        return bytes([address, count]) + self._bus.read(address, count)

    def _i2c_write(self, body, _):
        address, count = body[0], min(body[1], 20)
        self._bus.write(address, body[2 : 2 + count])
        return body

    def _register(self, body, _):
        address, value, action = struct.unpack_from(">IIB", body)
        if action == _PEEK_FIRMWARE:
            value = self._firmware.get(address, 0)
        elif action == _POKE_FIRMWARE:
            # The other words describe the device and must outlast a session.
            if address in (_FIRMWARE_LOCK_TIME, _FIRMWARE_LOCK_OWNER):
                self._firmware[address] = value
            if address == _FIRMWARE_LOCK_TIME and value == 0:
                self._on_close()
        elif action in _PEEKS:
            value = self._registers.peek((address - READBACK_BASE) // 4)
        elif action in _POKES and address >= SETTINGS_BASE:
            self._registers.poke((address - SETTINGS_BASE) // 4, value)
        return struct.pack(">IIB", address, value, action)
