# SPDX-License-Identifier: GPL-3.0-or-later
"""Forces that people type and that gauges send."""

import math

import pytest
from gnuradio.wiforce.calibration.gauges import ForceGauge, parse_force
from gnuradio.wiforce.errors import InputError


@pytest.mark.parametrize(
    ("typed", "force_n"),
    [
        ("2.5", 2.5),
        (" 2,5 ", 2.5),
        ("2.5N", 2.5),
        ("204 g", 2.000557),
        ("1 lb", 4.448222),
        ("-1", -1.0),
    ],
)
def test_typed_force_is_read_in_newtons(typed, force_n):
    """A person with a kitchen scale would calibrate in grams."""
    assert parse_force(typed) == pytest.approx(force_n, rel=1e-6)


@pytest.mark.parametrize(
    ("typed", "rule"),
    [
        *((text, "must be a number") for text in ("", "2.5 3", "nan", "0x10")),
        ("20 mm", "must be one of N, mN, kN, g, kg, lb, oz"),
    ],
)
def test_typed_text_that_is_no_force_is_refused(typed, rule):
    """Somebody types the location where the force is asked for."""
    with pytest.raises(InputError, match=rule):
        parse_force(typed)


@pytest.mark.parametrize(
    ("line", "unit", "force_n"),
    [
        ("ST,GS,+  1.234 kg", "N", 12.1014),
        ("  204.0 g\r", "N", 2.00056),
        ("3.02", "N", 3.02),
        ("302", "g", 2.96161),
        ("N1 -0.12N", "N", -0.12),
        ("12:30:05;2.50 N;OK", "N", 2.5),
    ],
)
def test_gauge_line_gives_force_of_its_unit(line, unit, force_n):
    gauge = ForceGauge("scale", unit)
    gauge.note(0.5, line)
    assert gauge.mean(0.0, 1.0)[0] == pytest.approx(force_n, rel=1e-5)


def test_gauge_mean_covers_the_interval_only_and_a_steady_force():
    """A press that sags while it is measured would get the mean of two forces."""
    gauge = ForceGauge("scale")
    for time_s, force_n in ((0.1, 9.0), (1.0, 2.0), (1.2, 2.02), (1.4, 1.98), (2.0, 9.0)):
        gauge.note_force(time_s, force_n)
    assert gauge.mean(1.0, 1.5) == (pytest.approx(2.0), pytest.approx(0.02))
    force_n, std_n = gauge.mean(1.9, 2.1)
    assert force_n == 9.0 and math.isnan(std_n)
    with pytest.raises(InputError, match="must show a steady force.*1.98 to 9.00 N"):
        gauge.mean(1.0, 2.1)


def test_gauge_that_stops_sending_is_reported_with_its_silence():
    gauge = ForceGauge("/dev/ttyUSB0")
    gauge.note_force(1.0, 2.0)
    gauge.check_alive(2.5)
    with pytest.raises(InputError, match="ttyUSB0: has sent no force for 3 s; check its cable"):
        gauge.check_alive(4.0)
    with pytest.raises(InputError, match="has sent no force during the measurement"):
        gauge.mean(1.5, 2.5)


def test_gauge_lines_without_a_number_are_quoted():
    """A scale at the wrong baud rate sends something, but no forces."""
    gauge = ForceGauge("scale")
    gauge.note(0.1, "~~?x")
    with pytest.raises(InputError, match=r"must send a number in each line, got '~~\?x'"):
        gauge.check_alive(3.0)
