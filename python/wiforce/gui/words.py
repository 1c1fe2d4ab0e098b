# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings in words."""


def values(reading, bounds=True):
    """Force and location with two standard deviations, or why there are none.

    Parameters
    ----------
    reading : Reading
    bounds : bool
        Whether to give the standard deviations, where space allows.
    """
    if reading.touch is None:
        return "no reading"
    if reading.touch == 0:
        return "not touched"
    force = _value(reading.force_n, bounds and reading.force_std_n, 2, "N")
    location = _value(reading.location_mm, bounds and reading.location_std_mm, 1, "mm")
    return f"{force}   {location}"


def _value(value, std, decimals, unit):
    if value is None:
        return f"? {unit}"
    spread = f" \u00b1 {2 * std:.{decimals}f}" if std else ""
    return f"{value:.{decimals}f}{spread} {unit}"


def doubts(reading):
    """The flags that put a reading in doubt."""
    return [flag for flag in reading.flags if flag != "reference"]


def notes(reading):
    """SNR and flags."""
    snr = [] if reading.snr_db is None else [f"SNR {reading.snr_db:.1f} dB"]
    return "  ".join([*snr, *reading.flags])
