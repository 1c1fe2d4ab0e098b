# SPDX-License-Identifier: GPL-3.0-or-later
"""The network between device and host, as far as it fails."""

import time
from collections.abc import Callable


class Network:
    """Passes datagrams, except while it is cut.

    ``now``: wall time in seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic):
        self._now = now
        self._until_s = -float("inf")
        self._tears = False  # the next packet

    @property
    def is_cut(self) -> bool:
        """Whether nothing passes in either direction."""
        return self._now() < self._until_s

    def cut(self, seconds: float) -> None:
        """Tear the packet that is sent next, and let nothing pass for some wall time."""
        self._until_s = self._now() + seconds
        self._tears = True

    def passed(self, packet: bytes) -> bytes:
        """What arrives of a packet that is sent now."""
        if not self.is_cut:
            return packet
        tears, self._tears = self._tears, False
        return packet[: len(packet) // 2] if tears else packet[:0]
