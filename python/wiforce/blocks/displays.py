# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows as blocks: spectrum, phases, trends and forces."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.estimators import RatioUnfolder, estimator_named
from ..estimation.groups import Array, Groups
from ..gui import ForceDisplay, Spectrum, Trend
from ..gui.style import end_labels
from ..planning.plan import Plan
from ..wiforce_python import phase_group_doppler
from . import names
from .argument_types import Kept, typed
from .group_block import GroupBlock, Tags, groups_of

# Lines that end 1 and end 2 have to themselves (paper, section 3.2).
_LINES = (1, 4)
_MISSING = pmt.intern(names.MISSING)


class doppler_display(Kept, gr.hier_block2):
    """Shows the Doppler spectrum of each phase group, with the lines of the tags marked.

    Input: vectors of a symbol's samples, a snapshot each, from ``preamble_fold`` or
    ``capture_source``. The attribute ``widget`` is the Qt widget, to be put into a window; a
    QApplication must exist.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    snapshots : int
        Length of a spectrum. Lines stand out most where it spans whole periods of the tags' clocks.
    title : str
        Above the plot.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> display = doppler_display(wiforce.plan("demo"))  # doctest: +SKIP
    >>> display.widget.show()  # doctest: +SKIP
    """

    @typed
    def __init__(
        self, plan: Plan, snapshots: int = 625, title: str = "Doppler spectrum of a phase group"
    ) -> None:
        if snapshots < 2:
            raise InputError("snapshots", "must be at least 2", snapshots)
        width = plan.waveform.symbol_length
        lines_hz = [line * clock_hz for clock_hz in plan.clocks_hz for line in _LINES]
        labels = end_labels(plan.require_scene().sensor_names)
        marks = dict(zip(labels, lines_hz, strict=True))
        self.widget = Spectrum(1 / plan.waveform.snapshot_period_s, marks, title)
        gr.hier_block2.__init__(
            self,
            "doppler_display",
            gr.io_signature(1, 1, width * gr.sizeof_gr_complex),
            gr.io_signature(0, 0, 0),
        )
        self._sink = _SpectrumSink(self.widget, snapshots, width)
        spectrum = phase_group_doppler.spectrum(snapshots, width)
        self.connect(self._impl, spectrum, self._sink.gateway)


class _SpectrumSink(Kept, gr.sync_block):
    """Passes the power of the latest complete group to a widget."""

    def __init__(self, widget: Spectrum, snapshots: int, width: int) -> None:
        self._widget, self._shape = widget, (snapshots, width)
        item = (np.complex64, snapshots * width)
        gr.sync_block.__init__(self, "spectrum_sink", in_sig=[item], out_sig=None)

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        items = input_items[0]
        first = self.nitems_read(0)
        # Zeros in place of missing snapshots would show the room at all frequencies.
        tags = self.get_tags_in_window(0, 0, len(items), _MISSING)
        complete = np.setdiff1d(np.arange(len(items)), [tag.offset - first for tag in tags])
        if len(complete):
            rows = items[complete[-1]].reshape(self._shape)
            self._widget.show_power(np.sum(rows.real**2 + rows.imag**2, axis=1))
        return len(items)


class phase_display(GroupBlock):
    """Shows the phase change of every end against the untouched sensor over time.

    Input: vectors 2S from ``subcarrier_average``, tagged ``state``. The attribute ``widget`` is the
    Qt widget, to be put into a window; a QApplication must exist.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``. The steps that its estimator ``paper`` gives are added
        up.
    title : str
        Above the plot.
    history_s : float
        Seconds of signal that are shown.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> display = phase_display(wiforce.plan("demo"))  # doctest: +SKIP
    >>> display.widget.show()  # doctest: +SKIP
    """

    @typed
    def __init__(
        self, plan: Plan, title: str = "Phase change of the ends", history_s: float = 10.0
    ) -> None:
        labels = end_labels(plan.require_scene().sensor_names)
        self.widget = Trend(
            labels, "phase (deg)", 1 / plan.group_period_s, history_s, title, (-180.0, 180.0)
        )
        self._unfolder = RatioUnfolder(estimator_named(plan.estimator).ratios)
        GroupBlock.__init__(self, "phase_display", len(labels), outputs=0)

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        groups = self._unfolder.process(groups_of(tags).having(ratios=items.astype(complex)))
        received = np.isfinite(groups.phase_std_deg) & (np.abs(groups.ratios) > 0)
        phases = np.where(received, np.degrees(np.angle(groups.ratios)), np.nan)
        for end, values in enumerate(phases.T):
            self.widget.add(end, values.tolist())
        return len(items), groups[:0]


class trend_display(Kept, gr.sync_block):
    """Shows slow streams, for example one value per phase group, over the last seconds.

    Input: one float stream per label. The attribute ``widget`` is the Qt widget, to be put into a
    window; a QApplication must exist. (GNU Radio's time sink waits until its buffer is full, which
    takes many seconds at such rates.)

    Parameters
    ----------
    labels : sequence of str
        One per stream.
    y_label : str
        With its unit.
    rate : float
        Items per second.
    history_s : float
        Seconds shown.
    title : str
        Above the plot.
    y_range : (float, float), optional
        Fixed; by default as the values ask for.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> trend = trend_display(("offset",), y_label="ppm", rate=28.0)  # doctest: +SKIP
    """

    @typed
    def __init__(
        self,
        labels: Sequence[str] = ("value",),
        y_label: str = "",
        rate: float = 28.0,
        history_s: float = 10.0,
        title: str = "",
        y_range: tuple[float, float] | None = None,
    ) -> None:
        self.widget = Trend(labels, y_label, rate, history_s, title, y_range)
        gr.sync_block.__init__(self, "trend_display", [np.float32] * len(labels), None)

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        for line, items in enumerate(input_items):
            self.widget.add(line, items.tolist())
        return len(input_items[0])


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
        self.take_messages(names.READINGS, self._on_reading)
        self.take_messages(names.TARE_STATE, self._on_tare_state)
        self.take_messages(names.WARNINGS, self._on_warning)
        self.message_port_register_out(pmt.intern(names.TARE))
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
