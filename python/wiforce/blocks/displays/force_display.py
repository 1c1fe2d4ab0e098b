# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: a window on the readings."""

from collections.abc import Iterator, Sequence
from typing import Any

import pmt
from gnuradio import gr

from ...gui import ForceDisplay
from .. import names
from ..argument_types import typed
from ..kept import Kept


class force_display(Kept, gr.basic_block):
    """Shows readings: every sensor with its press, force and location over time, SNR and flags.

    Message port ``readings`` (in): dicts as ``reader`` and ``force_inversion`` give them. Message
    port ``tare_state`` (in): dicts as ``reader`` gives them, shown beside the tare button. Message
    port ``warnings`` (in): dicts as ``reader`` gives them, shown until a reading has no flag.
    Message port ``tare`` (out): sent when the tare button is pressed. When the flowgraph has ended,
    the last readings stay, with their number. The attribute ``widget`` is
    the Qt widget, to be put into a window; a QApplication must exist.

    Parameters
    ----------
    length_mm : float
        Length of the sensors.
    force_span_n : float
        Force of the longest arrow.
    history_s : float
        Seconds of signal in the histories.
    strips_y_mm : sequence of float
        Positions of the strips of a surface, which is drawn from above; empty without one.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> display = force_display(length_mm=80.0)  # doctest: +SKIP
    >>> display.widget.show()  # doctest: +SKIP
    """

    @typed
    def __init__(
        self,
        length_mm: float = 80.0,
        force_span_n: float = 8.0,
        history_s: float = 20.0,
        strips_y_mm: Sequence[float] = (),
    ) -> None:
        gr.basic_block.__init__(self, "force_display", in_sig=None, out_sig=None)
        self.widget = ForceDisplay(length_mm, force_span_n, history_s, strips_y_mm=strips_y_mm)
        self.message_port_register_in(pmt.intern(names.READINGS))
        self.message_port_register_in(pmt.intern(names.TARE_STATE))
        self.message_port_register_in(pmt.intern(names.WARNINGS))
        self.message_port_register_out(pmt.intern(names.TARE))
        self.set_msg_handler(pmt.intern(names.WARNINGS), self._on_warning)
        self.set_msg_handler(pmt.intern(names.TARE_STATE), self._on_tare_state)
        self.set_msg_handler(pmt.intern(names.READINGS), self._on_reading)
        self.widget.tare_requested.connect(self._on_tare)

    def start(self) -> bool:
        self.widget.show_start()
        return bool(super().start())

    def stop(self) -> bool:
        self.widget.show_end(self._late)
        return bool(super().stop())

    def _late(self) -> Iterator[Any]:
        """Readings of the end of a stream: GNU Radio does not handle them any more."""
        port = pmt.intern(names.READINGS)
        while self.gateway.nmsgs(port):
            message = self.gateway.delete_head_nowait(port)
            if pmt.is_dict(message):
                yield pmt.to_python(message)

    def _on_reading(self, message: Any) -> None:
        if pmt.is_dict(message):
            self.widget.add(pmt.to_python(message))

    def _on_tare_state(self, message: Any) -> None:
        if pmt.is_dict(message):
            self.widget.show_tare(pmt.to_python(message))

    def _on_warning(self, message: Any) -> None:
        text = pmt.to_python(message).get(names.TEXT) if pmt.is_dict(message) else None
        if isinstance(text, str):
            self.widget.show_warning(text)

    def _on_tare(self) -> None:
        self.message_port_pub(pmt.intern(names.TARE), pmt.PMT_T)
