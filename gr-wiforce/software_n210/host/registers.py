# SPDX-License-Identifier: GPL-3.0-or-later
"""The register file: setting registers, passed on to their blocks, and readback words."""

from ..wire import SR_TIME

_COMPATIBILITY = (11 << 16) | 1
_REFERENCE_LOCKED = 1 << 11
_ALL_ONES = 0xFFFFFFFF


class Registers:
    """Setting registers by index, readback words by index."""

    def __init__(self, clock):
        self._clock = clock
        self._blocks = {}
        self.attach(SR_TIME, 6, clock.poke)

    def attach(self, base, count, poke):
        """Pass writes to ``base .. base + count - 1`` on to ``poke(register - base, value)``."""
        for register in range(count):
            self._blocks[base + register] = (poke, register)

    def poke(self, index, value):
        """Write a setting register; registers without a block are ignored."""
        block = self._blocks.get(index)
        if block is not None:
            poke, register = block
            poke(register, value)

    def peek(self, index):
        """A readback word."""
        if index in (10, 11):
            return _word(self._clock.time, index - 10)
        if index in (14, 15):
            return _word(self._clock.last_pulse, index - 14)
        # Word 9, the daughterboards' pins, reads all ones: every oscillator is locked.
        return {0: 0, 8: 0, 12: _COMPATIBILITY, 13: _REFERENCE_LOCKED}.get(index, _ALL_ONES)


def _word(value, low):
    return (value if low else value >> 32) & _ALL_ONES
