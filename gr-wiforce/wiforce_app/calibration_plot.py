# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of a calibration: what was measured, and the model's curves."""

import numpy as np
from gnuradio.wiforce.signal.carrier import same_carrier


def plot_calibration(table, model, path):
    """A calibration's phases and the model's curves against force, one panel per carrier and port.

    Parameters
    ----------
    table : CalibrationTable
    model : CurveModel
    path : str or Path
    """
    from matplotlib.figure import Figure

    count = len(model.carriers)
    canvas = Figure(figsize=(10, 1 + 3.6 * count), layout="constrained")
    panels = canvas.subplots(count, 2, squeeze=False)
    canvas.suptitle(f"{model.name}: phase against force, points measured, lines model")
    for carrier, row in zip(model.carriers, panels, strict=True):
        for port, axis in enumerate(row, 1):
            _plot_port(table, model, carrier, port, axis)
    canvas.savefig(path, dpi=110)


def _plot_port(table, model, carrier, port, axis):
    forces = np.linspace(*model.force_span_n, 80)
    own = (table.port == port) & same_carrier(table.frequency_hz, carrier.frequency_hz)
    for i, location in enumerate(carrier.location_mm):
        curve = model.phases_deg(forces, location, carrier.frequency_hz)[:, port - 1]
        curve = np.degrees(np.unwrap(np.radians(curve)))
        axis.plot(forces, curve, color=f"C{i}", label=f"{location:g} mm")
        here = own & (table.location_mm == location) & (table.force_n > 0)
        measured = table.phase_deg[here]
        near = np.interp(table.force_n[here], forces, curve)
        turns = np.round((near - measured) / 360)
        axis.plot(table.force_n[here], measured + 360 * turns, ".", ms=3, color=f"C{i}")
    axis.set_title(f"{carrier.frequency_hz / 1e6:g} MHz, port {port}", fontsize=10)
    axis.set_xlabel("force (N)")
    axis.set_ylabel("phase (deg)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
