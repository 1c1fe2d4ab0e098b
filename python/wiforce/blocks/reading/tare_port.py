# SPDX-License-Identifier: GPL-3.0-or-later
"""Message ports of a block that takes requests for a tare, and reports what became of them."""

import itertools
from collections.abc import Callable
from typing import Any

import pmt

from ...press.tares import StreamTares, TareState
from .. import names

_REQUEST, _CANCEL = "request", "cancel"


class TarePort:
    """Mix-in of a block with the ports ``tare`` (in) and ``tare_state`` (out).

    Requests come as messages, or from another thread by ``tare``.

    Examples
    --------
    >>> from gnuradio.wiforce.blocks.reading.group_reader import group_reader
    >>> issubclass(group_reader, TarePort)
    True
    """

    _post: Callable[[Any, Any], None]
    fail: Callable[[Exception], None]
    message_port_register_in: Callable[[Any], None]
    message_port_register_out: Callable[[Any], None]
    message_port_pub: Callable[[Any, Any], None]
    set_msg_handler: Callable[[Any, Any], None]
    to_basic_block: Callable[[], Any]

    def open_tare_port(self, requests: StreamTares) -> None:
        """Register the ports."""
        self._tares = requests
        self._numbers = itertools.count()
        self._asked: dict[int, Callable[[TareState], None]] = {}
        self._waiting: list[Callable[[TareState], None]] = []
        requests.on_state = self._on_tare_state
        self.message_port_register_in(pmt.intern(names.TARE))
        self.message_port_register_out(pmt.intern(names.TARE_STATE))
        self.set_msg_handler(pmt.intern(names.TARE), self._on_tare)

    def tare(self, force: bool = False, done: Callable[[TareState], None] | None = None) -> None:
        """Request a tare, from any thread.

        Parameters
        ----------
        force : bool
            Also while a sensor is touched.
        done : callable, optional
            Called once, in the block's thread, with the TareState in which the request ends:
            ``complete``, ``refused`` or ``failed``.
        """
        number = next(self._numbers)
        if done is not None:
            self._asked[number] = done
        self._send({names.FORCE: force, _REQUEST: number})

    def cancel_tare(self, reason: str) -> None:
        """Give up a tare that is being measured, from any thread."""
        self._send({_CANCEL: reason})

    def end_tare(self, reason: str) -> None:
        """Give up what is being measured or waits, at the end of the stream."""
        ended = self._tares.cancel(reason)
        if ended.state != "failed":
            ended = TareState("failed", reason)
        for done in [*self._asked.values(), *self._waiting]:
            done(ended)
        self._asked.clear()
        self._waiting.clear()

    def _send(self, message: dict[str, Any]) -> None:
        self.to_basic_block()._post(pmt.intern(names.TARE), pmt.to_pmt(message))

    def _on_tare(self, message: Any) -> None:
        try:
            self._take(_request_in(message))
        except Exception as error:
            self.fail(error)

    def _take(self, request: dict[str, Any]) -> None:
        if _CANCEL in request:
            self._tares.cancel(str(request[_CANCEL]))
            return
        number = request.get(_REQUEST)
        done = self._asked.pop(number, None) if isinstance(number, int) else None
        # Only true forces: what else somebody sends may be a mistake.
        state = self._tares.request(request.get(names.FORCE) is True)
        if done is None:
            return
        if state.state == "measuring":
            self._waiting.append(done)
        else:
            done(state)

    def _on_tare_state(self, state: TareState) -> None:
        self.message_port_pub(pmt.intern(names.TARE_STATE), pmt.to_pmt(state.row()))
        if state.state in ("complete", "failed"):
            waiting, self._waiting = self._waiting, []
            for done in waiting:
                done(state)


def _request_in(message: Any) -> dict[str, Any]:
    """Keys of a message; empty for anything else than a dict, which requests a tare as well."""
    values = pmt.to_python(message) if pmt.is_dict(message) else None
    return values if isinstance(values, dict) else {}
