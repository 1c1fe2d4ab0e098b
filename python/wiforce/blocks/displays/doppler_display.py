# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: a window on the Doppler spectrum of the snapshots."""

import numpy as np
import pmt
from gnuradio import gr

from ...errors import InputError
from ...estimation.groups import Array
from ...gui import Spectrum
from ...gui.words import end_labels
from ...planning.plan import Plan
from ...wiforce_python import phase_group_doppler
from .. import names
from ..argument_types import typed
from ..kept import Kept

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
