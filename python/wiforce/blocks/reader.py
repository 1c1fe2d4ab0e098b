# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: received samples to readings of force and location."""

from collections.abc import Callable
from threading import Event
from typing import Any

import numpy as np
from gnuradio import gr

from .. import names
from ..errors import InputError
from ..estimation.tare_request import TareState
from ..io.readings import GroupCounts, Reading
from ..io.samples import ITEM_TYPES
from ..planning.plan import Plan
from ..planning.plan import plan as plan_of
from ..receiver import Receiver
from ..scene import Scene
from ..wiforce_python import ofdm_channel_estimator, phase_group_doppler, preamble_fold
from .group_reader import group_reader

_ITEM_BYTES = {
    **{name: kind.sample_bytes for name, kind in ITEM_TYPES.items()},
    "folded": 64 * gr.sizeof_gr_complex,
}


class reader(gr.hier_block2):
    """Reads force and location from received samples.

    Message port ``readings`` (out): a dict per group and sensor (see ``force_inversion``).
    Message port ``tare`` (in): measure a new untouched reference; a dict with ``force`` true also
    while a sensor is touched. Message port ``tare_state`` (out): what became of it, a dict with
    ``state`` (``measuring``, ``complete``, ``refused``, ``failed``), ``reason`` and ``forced``.

    Parameters
    ----------
    scene : str, dict, Scene or Plan
        Scene file, the scene itself, or its plan.
    input_type : str
        ``fc32`` or ``sc16`` samples, or ``folded`` vectors from a ``recording_source``.
    frame_offset : int
        Samples before the first frame of the stream.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable, optional
        Called with every :class:`io.readings.Reading`.

    Attributes
    ----------
    plan : Plan
    receiver : Receiver
        Reads the groups.
    fold, doppler : block or None
        The block that extracts the tones, from samples or from folded vectors; the other is None.
    estimator : block
        The channel at every tone; its output can be tapped.
    groups : block
        The inner block that runs the receiver.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, file and key, rule and value.

    Examples
    --------
    >>> from gnuradio import blocks, gr
    >>> flowgraph = gr.top_block()
    >>> source = blocks.null_source(4)  # 16-bit samples
    >>> flowgraph.connect(source, reader("demo", input_type="sc16", on_reading=print))
    """

    def __init__(
        self,
        scene: str | dict[str, Any] | Scene | Plan,
        input_type: str = "fc32",
        frame_offset: int = 0,
        tracked: bool = False,
        on_reading: Callable[[Reading], None] | None = None,
    ) -> None:
        if input_type not in _ITEM_BYTES:
            rule = f"must be one of {', '.join(_ITEM_BYTES)}"
            raise InputError("input_type", rule, input_type)
        if frame_offset < 0:
            raise InputError("frame_offset", "must be 0 or more", frame_offset)
        self.plan = scene if isinstance(scene, Plan) else plan_of(scene)
        antennas = self.plan.scene.environment.receive_antennas if self.plan.scene else 1
        if antennas > 1 and input_type != "folded":
            rule = "must be 1 where samples come in; two antennas are folded, then antenna_ratio"
            raise InputError("environment.receive_antennas", rule, 2)
        gr.hier_block2.__init__(
            self,
            "reader",
            gr.io_signature(1, 1, _ITEM_BYTES[input_type]),
            gr.io_signature(0, 0, 0),
        )
        self.message_port_register_hier_out(names.READINGS)
        self.message_port_register_hier_out(names.TARE_STATE)
        self.message_port_register_hier_in(names.TARE)
        self.fold = self.doppler = None
        if input_type == "folded":
            first = self.doppler = self._make_doppler()
        else:
            first = self.fold = self._make_fold(input_type, frame_offset)
        waveform, table = self.plan.waveform, self.plan.table
        self.estimator = ofdm_channel_estimator(
            factors=waveform.equalizer().astype(np.complex64),
            rows=len(table.tones),
            rotation=table.derotation(waveform.sample_rate_hz).astype(np.complex64),
        )
        self.groups = group_reader(self.plan, tracked, on_reading)
        self.connect(self, first, self.estimator, self.groups)
        self.msg_connect(first, names.INCOMPLETE, self.groups, names.INCOMPLETE)
        self.msg_connect(self.groups, names.READINGS, self, names.READINGS)
        self.msg_connect(self.groups, names.TARE_STATE, self, names.TARE_STATE)
        self.msg_connect(self, names.TARE, self.groups, names.TARE)

    def _make_doppler(self) -> Any:
        return phase_group_doppler(
            weights=self.plan.table.weights, group_length=self.plan.group_length
        )

    def _make_fold(self, input_type: str, frame_offset: int) -> Any:
        waveform = self.plan.waveform
        return preamble_fold.tones(
            weights=self.plan.table.weights,
            group_length=self.plan.group_length,
            **waveform.folding,
            sample_rate=waveform.sample_rate_hz,
            frame_offset=frame_offset,
            item_type=input_type,
        )

    @property
    def receiver(self) -> Receiver:
        """The receiver that reads the groups."""
        return self.groups.receiver

    @property
    def failure(self) -> Exception | None:
        """The exception that ended the flowgraph; None without one."""
        return self.groups.failure

    @property
    def counts(self) -> GroupCounts:
        """Group counts by outcome: a :class:`io.readings.GroupCounts`."""
        return self.receiver.counts

    @property
    def ended(self) -> Event:
        """A threading.Event: the stream has ended and its last group is read."""
        return self.groups.ended

    def tare(self, force: bool = False, done: Callable[[TareState], None] | None = None) -> None:
        """Measure a new untouched reference in the groups that follow.

        Refused while a sensor is touched, unless forced. May be called from any thread.

        Parameters
        ----------
        force : bool
            Also while a sensor is touched; its readings are then flagged until a release is seen.
        done : callable, optional
            Called once, in another thread, with the TareState in which the request ends.
        """
        self.groups.tare(force, done)
