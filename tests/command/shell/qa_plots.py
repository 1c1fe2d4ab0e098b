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
        times, values = line_of(axis, "flagged")
        assert times.tolist() == [0.3]
        assert values[0] == axis.get_ylim()[1] < largest


def test_plot_of_flagged_readings_alone_shows_them(figures):
    """While every reading is weak, the force must still be visible."""
    weak = [reading for reading in readings() if reading.flags == ("weak",)]
    plot_readings(weak, "out.png")
    for axis, value in zip(figures[0].axes[:2], (40.0, 75.0), strict=False):
        assert line_of(axis, "flagged")[1].tolist() == [value]
        assert axis.get_ylim()[0] < value < axis.get_ylim()[1]


def test_plot_without_any_force_says_which_flags_there_are(figures):
    """An empty picture looks like a broken one."""
    plot_readings(
        [
            Reading(0.1, "arm", None, flags=("weak", "moved")),
            Reading(0.4, "arm", None, flags=("weak",)),
        ],
        "out.png",
    )
    force, *_, snr = figures[0].axes
    assert [text.get_text() for text in force.texts] == [
        "no reading has a force; flags: weak (2), moved (1)"
    ]
    assert np.allclose(snr.get_xlim(), (0.1, 1.1))


def test_plot_of_several_sensors_has_a_marker_for_each(figures):
    """A print in grey must tell the sensors from one another."""
    both = [replace(each, sensor=name) for name in ("arm", "leg") for each in readings()]
    plot_readings(both, "out.png", length_mm=80.0)
    force, location, phases, _ = figures[0].axes
    bars = [each.lines[0] for each in force.containers]
    assert [line.get_marker() for line in bars] == ["o", "s"]
    assert len({line.get_color() for line in bars}) == 2
    crosses = {line.get_label(): line for line in force.get_lines() if line.get_marker() == "x"}
    beyond = "flagged\n(at an edge: beyond it)"  # as the axis is that of the other readings
    assert set(crosses) == {f"arm, {beyond}", f"leg, {beyond}"}
    assert crosses[f"leg, {beyond}"].get_color() == bars[1].get_color()
    labels = [text.get_text() for text in phases.get_legend().get_texts()]
    assert labels == ["arm, psi 1", "arm, psi 2", "leg, psi 1", "leg, psi 2"]
    assert location.get_ylim() == (0.0, 80.0)


@pytest.mark.parametrize("with_length", [True, False])
def test_plot_of_readings_shows_whole_sensors_and_legends_beside(figures, with_length):
    """A zoomed location axis makes a tenth of a millimetre look like a movement."""
    plot_readings(readings(), "out.png", length_mm=100.0 if with_length else None)
    canvas = figures[0]
    canvas.draw_without_rendering()
    low, high = canvas.axes[1].get_ylim()
    assert low == 0.0 and (high == 100.0 if with_length else 40.0 < high < 75.0)
    for axis in (canvas.axes[0], canvas.axes[2]):
        beside = axis.get_legend().get_window_extent()
        assert beside.x0 >= axis.get_window_extent().x1 and beside.x1 <= canvas.bbox.x1


@pytest.fixture(scope="module")
def calibration():
    """A table whose phases cross 180 deg, and its model."""
    true = replace(load_sensor("line-900mhz"), port_offset_deg=(100.0, -60.0))
    table = measure_vna(true, [20.0, 30.0, 40.0, 50.0, 60.0], np.arange(1.0, 8.1), seed=1)
    return table, calibrate(table, "arm")


def test_plot_of_calibration_has_residuals_of_all_presses(figures, calibration):
    """A press that does not fit is seen in the residuals and nowhere else."""
    table, model = calibration
    plot_calibration(table, model, "out.png")
    for port, axis in ((1, figures[0].axes[2]), (2, figures[0].axes[5])):
        for location in model.carriers[0].location_mm:
            forces, residuals = line_of(axis, f"{location:g} mm")
            rows = table.take(
                (table.port == port) & (table.location_mm == location) & ~table.untouched
            )
            expected = wrap_deg(
                rows.phase_deg - model.phases_deg(rows.force_n, location)[:, port - 1]
            )
            np.testing.assert_array_equal(forces, rows.force_n)
            np.testing.assert_allclose(residuals, expected, atol=1e-9)
            assert 0 < np.std(residuals) < 1.0


def test_plot_of_calibration_phases_are_not_wrapped(figures, calibration):
    """A jump by 360 deg hides the shape of a curve, and whether a measurement belongs to it."""
    table, model = calibration
    assert np.ptp(table.phase_deg[~table.untouched]) > 300, "the phases must cross 180 deg"
    plot_calibration(table, model, "out.png")
    untouched = model.untouched_deg()
    for row in (0, 1):
        for axis in figures[0].axes[3 * row : 3 * row + 2]:
            *drawn, dashed = axis.get_lines()
            for line in drawn:
                assert np.max(np.abs(np.diff(line.get_ydata())), initial=0) < 60
            assert dashed.get_label() == "untouched"
            assert wrap_deg(dashed.get_ydata()[0] - untouched[row]) == pytest.approx(0, abs=1e-9)


def test_plot_of_calibration_shows_phases_against_location(figures, calibration):
    """The location is read from these slopes; a wrong ruler entry is seen here."""
    table, model = calibration
    plot_calibration(table, model, "out.png")
    for port, axis in ((1, figures[0].axes[1]), (2, figures[0].axes[4])):
        for force_n in (1.0, 8.0):
            locations, phases = line_of(axis, f"{force_n:g} N")
            assert (locations[0], locations[-1]) == (20.0, 60.0)
            expected = model.phases_deg(force_n, locations)[:, port - 1]
            np.testing.assert_allclose(wrap_deg(phases - expected), 0, atol=1e-9)
            # The shorted line gets longer from port 1, so its phase falls.
            assert np.all(np.diff(phases) < 0) == (port == 1)
