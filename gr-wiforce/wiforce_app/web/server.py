# SPDX-License-Identifier: GPL-3.0-or-later
"""The server of the page: its connections, what each browser is sent, and the plots."""

import asyncio
import contextlib
import json
import logging
import math
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import tornado.httpserver
import tornado.iostream
import tornado.web
import tornado.websocket
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure
from bokeh.resources import Resources
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import is_loopback, request

from .address import PageAddress
from .sources import FileSource, PageState, ZmqSource, loaded

_ASSETS = Path(__file__).with_name("assets")
# Readings of short groups are collected for so long.
_TICK_S = 0.03
# Of signal that viewers can scroll back to.
HISTORY_S = 600.0
_STATUS_S = 0.5  # as often as heartbeats come
# A tare takes as long as the reference, some seconds at most.
_ANSWER_S = 60.0
# Of connections that have died without a word; Tornado ends them after three of these.
_PING_S = 20.0
_LONGEST_REQUEST = 1024
_IDLE_S = 60.0
_NEW = (-1, 0)
# The page may load nothing from elsewhere. Bokeh sets styles from scripts.
_POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class PageServer:
    """Serves one source; ``length_mm`` is the length of sensors whose source does not state it."""

    def __init__(
        self,
        source: FileSource | ZmqSource,
        address: PageAddress,
        listening: socket.socket,
        history_s: float = HISTORY_S,
        length_mm: float | None = None,
    ):
        self.source, self.address = source, address
        self.page_state = PageState(history_s)
        self.viewers: set[_Viewer] = set()
        self._listening = listening
        self._status_s = -math.inf
        # What the page has to know before the first message.
        self.settings = {
            "history_s": history_s if math.isfinite(history_s) else None,
            "length_mm": length_mm,
        }
        self._ending = asyncio.Event()

    async def serve(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Serve until `end` is called, or ``ended`` is true and everything was sent."""
        server = tornado.httpserver.HTTPServer(
            self._application(),
            idle_connection_timeout=_IDLE_S,
            body_timeout=_IDLE_S,
            max_body_size=_LONGEST_REQUEST,
        )
        server.add_sockets([self._listening])
        try:
            while not self._ending.is_set():
                last = ended()
                self._tick(final=last)
                if last:
                    break
                await asyncio.sleep(_TICK_S)
            await self._flush()
        finally:
            server.stop()
            for viewer in tuple(self.viewers):
                viewer.drop()
            await server.close_all_connections()
            self.source.close()

    def end(self) -> None:
        """End soon; may be called from a signal handler of the loop."""
        self._ending.set()

    def _tick(self, final: bool = False) -> None:
        self.source.poll(self.page_state)
        now = time.monotonic()
        if status := final or now - self._status_s >= _STATUS_S:
            self._status_s = now
        for viewer in tuple(self.viewers):
            viewer.update(status)

    async def _flush(self, limit_s: float = 1.0) -> None:
        """Let the last messages leave."""
        waiting = [viewer.sent for viewer in self.viewers if viewer.sent is not None]
        if waiting:
            await asyncio.wait(waiting, timeout=limit_s)

    def _application(self) -> tornado.web.Application:
        own, bokeh = {"page": self}, str(_bokeh_scripts()[0].parent)
        return tornado.web.Application(
            [
                ("/", _Page, own),
                ("/figures.json", _Figures, own),
                ("/readings", _Viewer, own),
                ("/bokeh/(.*)", _File, {**own, "path": bokeh}),
                ("/assets/(.*)", _File, {**own, "path": str(_ASSETS)}),
            ],
            default_handler_class=_Missing,
            default_handler_args=own,
            websocket_ping_interval=_PING_S,
            websocket_max_message_size=_LONGEST_REQUEST,
            template_path=str(_ASSETS),
            log_function=lambda handler: None,
        )

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token; browsers share cookies between ports."""
        return f"gr-wiforce-{self.address.port}"


class _Guarded(tornado.web.RequestHandler):
    """A handler that answers only those who may look."""

    def initialize(self, page: PageServer) -> None:
        self.page = page

    def set_default_headers(self) -> None:
        self.set_header("Server", "gr-wiforce")
        self.set_header("Content-Security-Policy", _POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")

    def prepare(self) -> None:
        if self.request.method not in ("GET", "HEAD"):
            raise tornado.web.HTTPError(405)
        if self.page.address.token is None:
            # A page elsewhere whose name was made to lead here must not read what is shown.
            if not is_loopback(f"tcp://{self.request.host_name}:0"):
                raise tornado.web.HTTPError(403, reason="Forbidden host name")
            return
        given = self.get_query_argument("token", None)
        if not self.page.address.accepts(given or self.get_cookie(self.page.cookie) or ""):
            raise tornado.web.HTTPError(403, reason="Token missing or wrong")
        if given is not None:
            self.set_cookie(self.page.cookie, given, httponly=True, samesite="Strict")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        hint = "; open the address that gr-wiforce printed" if status_code == 403 else ""
        self.finish(f"{self._reason}{hint}\n")


class _Missing(_Guarded):
    def prepare(self) -> None:
        super().prepare()
        raise tornado.web.HTTPError(404)


class _Page(_Guarded):
    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.render("page.html", scripts=[f"bokeh/{path.name}" for path in _bokeh_scripts()])


class _Figures(_Guarded):
    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("Content-Type", "application/json")
        self.write(json.dumps({"figures": _figures(), **self.page.settings}))


class _File(_Guarded, tornado.web.StaticFileHandler):
    """A file of the page, sent in pieces, so that a slow browser holds one piece in memory."""

    def initialize(self, page: PageServer, path: str) -> None:
        _Guarded.initialize(self, page)
        tornado.web.StaticFileHandler.initialize(self, path)

    def validate_absolute_path(self, root: str, absolute_path: str) -> str | None:
        if "\0" in absolute_path:  # which the system's calls do not take
            raise tornado.web.HTTPError(404)
        return super().validate_absolute_path(root, absolute_path)

    def set_extra_headers(self, path: str) -> None:
        # Asked for again each time, and sent again after an update only.
        self.set_header("Cache-Control", "no-cache")


class _Viewer(_Guarded, tornado.websocket.WebSocketHandler):
    """One browser, for which at most one message waits, then all that it lacks."""

    sent: "asyncio.Future[None] | None" = None

    def open(self, *_: str) -> None:
        self.answers: deque[str] = deque()
        self._position, self._asks = _NEW, False
        self.set_nodelay(True)
        self.page.viewers.add(self)
        self.update(status=True)

    def on_close(self) -> None:
        self.page.viewers.discard(self)

    def on_message(self, message: str | bytes) -> None:
        if self.page.source.control is not None and not self._asks:
            if message in ("tare", "tare force"):
                self._asks = True
                given = str(message), asyncio.get_running_loop()
                # A reader that hangs must not delay the end of the page.
                threading.Thread(target=self._ask, args=given, daemon=True).start()

    def _ask(self, word: str, loop: asyncio.AbstractEventLoop) -> None:
        """Ask the reader for a tare, in a thread."""
        source = self.page.source
        assert source.control is not None
        try:
            text = request(source.control, word, _ANSWER_S, source.keys)
        except InputError as error:
            text = json.dumps({"ok": False, "error": str(error)})
        silence = {"ok": False, "error": f"no answer from the reader in {_ANSWER_S:g} s"}
        answer = silence if text is None else loaded(text)
        with contextlib.suppress(RuntimeError):  # the page has ended meanwhile
            loop.call_soon_threadsafe(self._take_answer, answer)

    def _take_answer(self, answer: dict[str, Any]) -> None:
        self._asks = False
        self.answers.append(json.dumps({"answer": answer}))

    def update(self, status: bool) -> None:
        """Send what the browser lacks, unless it has not taken the last message yet."""
        page_state = self.page.page_state
        if self.sent is not None and not self.sent.done():
            return
        if self.answers:
            self._send(self.answers.popleft())
        elif self._position != page_state.position or status:
            text = page_state.message(self._position, status or self._position == _NEW)
            self._position = page_state.position
            self._send(text)

    def _send(self, text: str) -> None:
        try:
            written = self.write_message(text)
        except tornado.websocket.WebSocketClosedError:
            self.page.viewers.discard(self)
            return
        self.sent = asyncio.ensure_future(_done(written))

    def drop(self) -> None:
        """Disconnect at once: a handshake at the end would wait for the browser."""
        self.page.viewers.discard(self)
        if self.ws_connection is not None:
            self.ws_connection.stream.close()


async def _done(written: Any) -> None:
    try:
        await written
    except (tornado.websocket.WebSocketClosedError, tornado.iostream.StreamClosedError):
        pass


def serve_until_signal(
    make: Callable[[], PageServer],
    ended: Callable[[], bool] = lambda: False,
    signals: Iterable[int] = (signal.SIGINT, signal.SIGTERM),
) -> None:
    """Serve in this thread until a signal; ``make`` makes the server, within the loop."""
    # Refused requests are the browser's business, and would fill a journal.
    logging.getLogger("tornado").setLevel(logging.CRITICAL)

    async def run():
        server = make()
        loop = asyncio.get_running_loop()
        for number in signals:
            loop.add_signal_handler(number, server.end)
        await server.serve(ended)

    asyncio.run(run())


# Python describes the plots, and ``assets/plots.js`` paints them and fills their sources by name:
# `lines`, `bands` and `points` with readings that have no flag, the strip with a mark for each one
# that has.
_HEIGHT_PX = 210
# The same on both plots, so that their time axes are aligned.
_LEFT_PX, _RIGHT_PX = 52, 10
_UPRIGHT = math.pi / 2
_SOURCES = {
    "lines": ("xs", "ys", "color", "dash"),
    "bands": ("xs", "ys", "color"),
    "points": ("x", "y", "color"),
}
_STRIP_PX = 30
# Nothing takes touches, so that a phone can scroll over the plots.
_PLAIN = {
    "sizing_mode": "stretch_width",
    "tools": "",
    "toolbar_location": None,
    "min_border_left": _LEFT_PX,
    "min_border_right": _RIGHT_PX,
    "lod_threshold": None,
}


def _bokeh_scripts() -> list[Path]:
    """The files of Bokeh that the page needs, as they are installed with it."""
    return [Path(path) for path in Resources(mode="absolute", components=["bokeh"]).js_files]


@cache
def _figures() -> dict[str, Any]:
    """The plots, in the form that Bokeh's ``embed_item`` takes."""
    time_axis = Range1d(0, 30, name="time")
    force = _plot("force", "force (N)", time_axis)
    location = _plot("location", "location (mm)", time_axis)
    force.xaxis.major_label_text_font_size = "0px"
    location.xaxis.axis_label = "time (s)"
    plots = (_strip(time_axis), force, location)
    return json_item(column(*plots, sizing_mode="stretch_width", spacing=0))


def _strip(time_axis: Range1d) -> figure:
    """Times of readings with a flag, a row for each sensor: their values are not to be used."""
    ranges = {"x_range": time_axis, "y_range": Range1d(-1, 1, name="strip-range")}
    borders = {"min_border_top": 4, "min_border_bottom": 2}
    plot = figure(name="strip-plot", height=_STRIP_PX, **ranges, **borders, **_PLAIN)
    data = ColumnDataSource({key: [] for key in ("x", "y", "color")}, name="strip-marks")
    plot.scatter("x", "y", source=data, marker="dash", angle=_UPRIGHT, size=8, line_color="color")
    plot.axis.visible = False
    plot.grid.grid_line_color = None
    return plot


def _plot(name: str, label: str, time_axis: Range1d) -> figure:
    """One quantity over time."""
    ranges = {"x_range": time_axis, "y_range": Range1d(0, 1, name=f"{name}-range")}
    shape = {"height": _HEIGHT_PX, "min_border_top": 8}
    plot = figure(name=f"{name}-plot", y_axis_label=label, **ranges, **shape, **_PLAIN)
    data = {
        kind: ColumnDataSource({key: [] for key in keys}, name=f"{name}-{kind}")
        for kind, keys in _SOURCES.items()
    }
    color = {"line_color": "color"}
    plot.patches(
        "xs", "ys", source=data["bands"], fill_color="color", fill_alpha=0.2, line_color=None
    )
    plot.multi_line("xs", "ys", source=data["lines"], line_width=2, line_dash="dash", **color)
    plot.scatter("x", "y", source=data["points"], size=4, fill_color="color", line_color=None)
    plot.xgrid.grid_line_color = None
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_font_style = "normal"
        axis.minor_tick_line_color = None
    return plot
