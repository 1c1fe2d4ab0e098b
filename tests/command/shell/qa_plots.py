# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of readings and calibrations: what is drawn, and where."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import measure_vna
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.signal.carrier import wrap_deg
from wiforce_app.calibrate.calibrate import plot_calibration
from wiforce_app.shell.plots import plot_readings


@pytest.fixture
def figures(monkeypatch, tmp_path):
    """The figures that are saved, instead of what they hold."""
    from matplotlib.figure import Figure

    saved = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *args, **options: saved.append(figure))
    monkeypatch.chdir(tmp_path)
    return saved


def line_of(axis, label):
    (line,) = [line for line in axis.get_lines() if line.get_label().startswith(label)]
    return line.get_xdata(), line.get_ydata()


def readings():
    """Untouched, pressed, one absurd flagged reading, pressed, untouched."""
    pressed = Reading(
        time_s=0.2,
        sensor="arm",
        touch=1,
        force_n=4.0,
        force_std_n=0.1,
        location_mm=40.0,
        location_std_mm=0.5,
    )
    absurd = replace(pressed, time_s=0.3, force_n=40.0, location_mm=75.0, flags=("weak",))
    return [
        Reading(0.1, "arm", touch=0, flags=("reference",)),
        pressed,
        absurd,
        replace(pressed, time_s=0.4, force_n=5.0),
        Reading(0.5, "arm", touch=0),
    ]


def test_plot_of_readings_draws_no_force_while_untouched(figures):
    """A gap in the force looks like a lost sensor."""
    plot_readings(readings(), "out.png")
    force, location = figures[0].axes[:2]
    (bars,) = force.containers
    np.testing.assert_array_equal(bars.lines[0].get_xdata(), [0.1, 0.2, 0.4, 0.5])
    np.testing.assert_array_equal(bars.lines[0].get_ydata(), [0.0, 4.0, 5.0, 0.0])
    (bars,) = location.containers
    np.testing.assert_array_equal(bars.lines[0].get_ydata(), [40.0, 40.0])


def test_plot_of_readings_crosses_flagged_ones_without_a_wider_axis(figures):
    """One absurd reading must not flatten all others, nor look as reliable as they do."""
    plot_readings(readings(), "out.png")
    for axis, largest in zip(figures[0].axes[:2], (6.0, 45.0), strict=False):
        assert line_of(axis, "flagged")[0].tolist() == [0.3]
        assert axis.get_ylim()[1] < largest


@pytest.fixture(scope="module")
def calibration():
    """A table whose phases cross 180 deg, and its model."""
    true = replace(load_sensor("line-900mhz"), port_offset_deg=(100.0, -60.0))
    table = measure_vna(true, [20.0, 30.0, 40.0, 50.0, 60.0], np.arange(1.0, 8.1), seed=1)
    return table, calibrate(table, "arm")


def test_plot_of_calibration_has_phases_and_residuals_of_all_presses(figures, calibration):
    """A press that does not fit is seen in the residuals; a jump by 360 deg would hide a curve."""
    table, model = calibration
    assert np.ptp(table.phase_deg[~table.untouched]) > 300, "the phases must cross 180 deg"
    plot_calibration(table, model, "out.png")
    for port in (1, 2):
        phases, residuals = figures[0].axes[2 * port - 2 : 2 * port]
        for line in phases.get_lines():
            assert np.max(np.abs(np.diff(line.get_ydata()))) < 60
        for location in model.carriers[0].location_mm:
            forces, beside = line_of(residuals, f"{location:g} mm")
            rows = table.take((table.port == port) & (table.location_mm == location))
            expected = model.phases_deg(rows.force_n, location)[:, port - 1]
            np.testing.assert_array_equal(forces, rows.force_n)
            np.testing.assert_allclose(beside, wrap_deg(rows.phase_deg - expected), atol=1e-9)
            assert 0 < np.std(beside) < 1.0
