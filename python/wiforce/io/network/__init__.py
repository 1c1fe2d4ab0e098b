# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings, requests and samples between processes: ZMQ, Foxglove, LSL; where servers listen."""

import ipaddress
import re

from ...errors import InputError

_NAMES = {"": "127.0.0.1", "localhost": "127.0.0.1", "*": "0.0.0.0"}
_BROADCAST = "255.255.255.255"


def is_port(text: str) -> bool:
    """Whether a text is the number of a port."""
    return re.fullmatch("[0-9]{1,5}", text) is not None and 0 < int(text) < 65536


def listening_address(text: str, option: str) -> tuple[str, int]:
    """Where to listen, from ``PORT`` (on loopback) or ``ADDRESS:PORT``; ``*`` are all addresses.

    The address is an IP address, in brackets for IPv6, and returned without them.
    """
    host, _, port = text.rpartition(":")
    host = _NAMES.get(host, host)
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    try:
        address = ipaddress.ip_address(host)
        # The system binds these, but nobody can connect to them.
        unreachable = address.is_multicast or host == _BROADCAST
        if unreachable or not is_port(port):
            raise ValueError
    except ValueError:
        rule = "must be PORT or ADDRESS:PORT, with an IP address of this machine or *"
        raise InputError(option, rule, text) from None
    return host, int(port)
