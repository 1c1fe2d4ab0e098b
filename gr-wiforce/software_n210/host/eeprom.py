# SPDX-License-Identifier: GPL-3.0-or-later
"""EEPROM images that identify the device, and the I2C bus that they are on."""

import ipaddress
import struct

from ..wire import Malformed

MOTHERBOARD = 0x50
DAUGHTERBOARD_TX = 0x54
DAUGHTERBOARD_RX = 0x55

_N210_R4 = 0x0A11
_SIZE = 256


def motherboard_image(address, serial):
    """EEPROM of an N210 r4 at the given IPv4 address; 256 bytes."""
    image = bytearray(b"\xff" * _SIZE)
    packed = ipaddress.IPv4Address(address).packed
    struct.pack_into("<H", image, 0, _N210_R4)
    image[2:8] = b"\x02\x00" + packed
    image[8:12] = bytes([255, 0, 0, 0])
    image[12:16] = packed
    struct.pack_into("<HH", image, 18, 4, _N210_R4)
    image[23] = 0
    image[24:33] = serial.encode("ascii")[:9].ljust(9, b"\0")
    image[33:56] = bytes(23)  # no name
    image[56:60] = packed
    return image


def daughterboard_image(board_id):
    """EEPROM of a daughterboard with this id; 256 bytes, of which 32 are used."""
    image = bytearray(32)
    image[0] = 0xDB
    struct.pack_into("<H", image, 1, board_id)
    image[9:18] = b"1".ljust(9, b"\0")  # its serial number
    image[31] = -sum(image[:31]) & 0xFF
    return image + bytearray(b"\xff" * (_SIZE - 32))


class I2cBus:
    """EEPROMs by address, read through a pointer like the real parts, and write-protected.

    They identify the device. Anybody who reaches the control port may send a write, and every later
    session would find another device.
    """

    def __init__(self, images):
        self._images = images
        self._pointers = dict.fromkeys(images, 0)

    def write(self, address, data):
        """The first byte sets the pointer.

        Raises Malformed when bytes to be stored follow.
        """
        if address not in self._images or not data:
            return
        if len(data) > 1:
            raise Malformed(f"write to the protected EEPROM at {address:#x}")
        self._pointers[address] = data[0]

    def read(self, address, count):
        """`count` bytes from the pointer on; an address nobody answers reads as erased.

        Raises Malformed for more than the 20 bytes a message holds.
        """
        if count > 20:
            raise Malformed(f"I2C read of {count} bytes")
        image = self._images.get(address)
        if image is None:
            return b"\xff" * count
        start = self._pointers[address]
        self._pointers[address] = (start + count) % len(image)
        return bytes(image[(start + i) % len(image)] for i in range(count))
