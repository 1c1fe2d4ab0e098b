# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of readings."""

import io
from pathlib import Path

from gnuradio.wiforce.errors import InputError, unwritable
from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.io.text.textfile import check_output, replacing

_SUFFIXES = (".png", ".pdf", ".svg")
_PANEL_IN = 2.1  # height of a panel


def check_picture(path, inputs=()):
    """Check the path of a picture, or None, before any work is done for it."""
    if path is None:
        return
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(path, "name of a picture must end in .png, .pdf or .svg")
    optional_module("matplotlib.figure", path)
    check_output(path, inputs)


def legend_below(canvas, lines, labels, ncols):
    """Add a legend below all panels; Matplotlib before 3.7 has no location "outside"."""
    height = (0.24 * -(-len(labels) // ncols) + 0.15) / canvas.get_figheight()
    canvas.get_layout_engine().set(rect=(0, height, 1, 1 - height))
    canvas.legend(lines, labels, loc="lower center", ncols=ncols, fontsize=10, frameon=False)


def save_picture(canvas, path):
    """Write a figure; the file appears when it is complete."""
    path = Path(path)
    try:
        with replacing(path) as part:
            content = io.BytesIO()  # the writer of PDF hides the errors of a file
            canvas.savefig(content, dpi=110, format=path.suffix[1:].lower())
            part.write_bytes(content.getbuffer())
    except OSError as error:
        raise unwritable(path, error) from error


def plot_readings(readings, path, title="", truth=None, length_mm=None):
    """Write the picture that :func:`gnuradio.wiforce.plot` draws."""
    from gnuradio.wiforce.receiver.plotting import PANELS, plot  # needs NumPy and pandas
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(11, 1.0 + _PANEL_IN * PANELS), layout="constrained")
    axes = canvas.subplots(PANELS, 1, sharex=True)
    canvas.suptitle(title, fontsize=11)
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time (s)")
    plot(readings, truth=truth, axes=axes, length_mm=length_mm)
    save_picture(canvas, path)
