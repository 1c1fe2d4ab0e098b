# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps two processes of a machine from using the same device."""

import contextlib
import errno
import hashlib
import socket
import time
from weakref import WeakValueDictionary

from ...errors import InputError

_HANDOVER_S = 4.0  # UHD takes 1.5 s to close a device
_LOOK_S = 0.1


class _Name(socket.socket):
    """A name that is held until nothing in this process refers to it any more."""

    def __del__(self) -> None:
        self.close()


# Names that this process holds: its blocks may use a device together.
_held: WeakValueDictionary[str, _Name] = WeakValueDictionary()


class DeviceBusy(InputError):
    """The device is in use by another process of this machine."""


class DeviceLock:
    """Held while a process uses a device; raises DeviceBusy when another process holds it.

    What names the device in UHD's ``args``, known before it is opened, and its serial number are
    names in Linux's abstract namespace of sockets: they disappear with the process, however it
    ends, and all users see them; other network namespaces, as of containers, do not. ``handover_s``
    is the wait for a process that is about to close it, ``where`` what states the arguments.
    """

    def __init__(self, args: str, handover_s: float = _HANDOVER_S, where: str = "--args") -> None:
        self._args, self._where = args, where
        self._names: list[_Name] = []
        deadline = time.monotonic() + handover_s
        try:
            for name in _names(args):
                self._take(name, deadline)
        except DeviceBusy:
            self.release()
            raise

    def take_serial(self, serial: str | None) -> None:
        """Hold the device by its serial number too, as it may be open by other arguments."""
        if serial:
            self._take(f"serial={serial}", deadline=0.0)

    def release(self) -> None:
        """Let other processes use the device."""
        self._names.clear()

    def _take(self, name: str, deadline: float) -> None:
        # Arguments of the process and what devices state may hold bytes that are no UTF-8.
        known = hashlib.sha256(name.encode(errors="surrogateescape")).hexdigest()
        address = f"\0gr-wiforce/{known[:32]}"
        if (holder := _held.get(address)) is not None:
            self._names.append(holder)
            return
        holder = _Name(socket.AF_UNIX, socket.SOCK_STREAM)
        while True:
            try:
                holder.bind(address)
                _held[address] = holder
                self._names.append(holder)
                return
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
            if time.monotonic() > deadline:
                rule = "must name a device that is free (in use by another process)"
                raise DeviceBusy(self._where, rule, self._args)
            time.sleep(_LOOK_S)


def _names(args: str) -> list[str]:
    """What identifies each device in UHD's arguments; all of them where nothing does."""
    found = []
    for pair in args.split(","):
        key, _, value = (part.strip() for part in pair.partition("="))
        key = key.rstrip("0123456789")
        if key in ("addr", "second_addr", "mgmt_addr"):
            # UnicodeError: a label that is too long or empty, or no text at all.
            with contextlib.suppress(OSError, UnicodeError):
                value = socket.gethostbyname(value)
            found.append(f"addr={value}")
        elif key in ("serial", "name", "resource"):
            found.append(f"{key}={value}")
    return found or [args]
