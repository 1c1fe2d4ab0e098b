# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits of connections, so that no browser takes the page's process from the others."""

import asyncio
import resource
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import tornado.httpserver
import tornado.iostream

# A viewer whose last message has not left this machine for so long is disconnected.
STALLED_S = 20.0
# Of data that wait in the system, for each connection. Its own limit is some megabytes: a viewer
# that stalls would be noticed after minutes only, and files would be sent without a pause.
_KERNEL_BYTES = 32 << 10
# Beyond as many connections, further ones are closed, however many descriptors there are: in
# containers a million.
_MOST_DESCRIPTORS = 512


class LimitedServer(tornado.httpserver.HTTPServer):
    """A server that refuses connections before the process has no descriptor left.

    Tornado would try to accept them again and again, and print a traceback each time, for
    everybody who opens a thousand connections, with or without the token. It also has no limit for
    an answer that nobody reads; the system closes such connections.
    """

    def handle_stream(self, stream: tornado.iostream.IOStream, address: Any) -> None:
        # A new descriptor is the lowest that is free. The upper half is for files that are sent.
        most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if stream.socket.fileno() > min(most // 2, _MOST_DESCRIPTORS):
            stream.close()
            return
        stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            limit_ms = round(1000 * STALLED_S)
            stream.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, limit_ms)
        super().handle_stream(stream, address)


def in_turn(read: Callable[[int], Awaitable[bytes]]) -> Callable[[int], Awaitable[bytes]]:
    """Read only after all others had their turn.

    ``read``: reads so many bytes of a stream.
    """

    async def paced(length: int) -> bytes:
        await asyncio.sleep(0)
        return await read(length)

    return paced
