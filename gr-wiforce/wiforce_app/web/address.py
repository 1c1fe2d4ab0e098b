# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the page is served, and the token that opens it."""

import hmac
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network import listening_address
from gnuradio.wiforce.io.optional import check_installed

OPTION = "--web"
_EVERYWHERE = ("0.0.0.0", "::")
# 192 random bits cannot be guessed over a network.
_TOKEN_BYTES = 24
_TOKEN = re.compile("[A-Za-z0-9_-]{16,128}")
# Connections that wait to be accepted.
_BACKLOG = 128


@dataclass(frozen=True)
class PageAddress:
    host: str  # that the port is opened at, without brackets
    port: int
    token: str | None = None  # what a browser must present; None: all of this machine may look

    @classmethod
    def of(cls, text: str, token: str | None = None) -> "PageAddress":
        """The address of ``--web``, where beyond loopback a random token is made by default."""
        # Bokeh draws the plots; Tornado, which it brings along, serves the page.
        check_installed(OPTION, ("bokeh", "tornado"))
        host, port = listening_address(text, OPTION)
        if token is not None and not _TOKEN.fullmatch(token):
            raise InputError("--web-token", "must be 16 to 128 letters, digits, - or _")
        if token is None and not cls(host, port).is_loopback:
            token = secrets.token_urlsafe(_TOKEN_BYTES)
        return cls(host, port, token)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        return ipaddress.ip_address(self.host).is_loopback

    @property
    def url(self) -> str:
        """What a user opens."""
        host = socket.gethostname() if self.host in _EVERYWHERE else self.host
        host = f"[{host}]" if ":" in host else host
        query = "" if self.token is None else f"?token={self.token}"
        return f"http://{host}:{self.port}/{query}"

    @property
    def notice(self) -> str:
        """Message for the user when the page is ready."""
        text = f"page: {self.url}"
        if self.is_loopback:
            return text
        return f"{text} (plain HTTP: whoever reads the network sees readings and the token)"

    def accepts(self, token: str) -> bool:
        """Whether a token is the right one; takes as long for every token."""
        return self.token is None or hmac.compare_digest(self.token.encode(), token.encode())

    def listen(self) -> socket.socket:
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        listening = socket.socket(family, socket.SOCK_STREAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((self.host, self.port))
            listening.listen(_BACKLOG)
        except OSError as error:
            listening.close()
            given = f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
            raise InputError(OPTION, f"cannot be opened ({error.strerror})", given) from error
        listening.setblocking(False)
        return listening
